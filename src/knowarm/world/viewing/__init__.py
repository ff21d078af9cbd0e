"""Viewing: strips, videos, pages with films, and recordings for Rerun."""
