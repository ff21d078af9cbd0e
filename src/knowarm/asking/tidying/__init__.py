"""Tidying: a plan from a graph and from what a network sees, and its command."""
