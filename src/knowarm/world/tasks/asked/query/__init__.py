"""Asking for one of several objects by a query."""
