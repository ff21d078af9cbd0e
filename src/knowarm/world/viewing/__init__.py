"""Viewing: strips, videos and the web viewer."""
