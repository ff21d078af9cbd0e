"""Asking for the part of an object that serves a purpose."""
