"""Asking for an instance of a family of objects."""
