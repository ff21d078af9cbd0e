"""Choosing one of several objects by a query."""
