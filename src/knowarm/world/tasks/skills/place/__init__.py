"""Placing: the tray, its skill, and the guide to it."""
