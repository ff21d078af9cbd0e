"""Bring your own robot: drafts of its description and checks of robots and objects."""
