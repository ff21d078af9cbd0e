"""Sorting: trays that stand for places, and the skill that puts things where they belong."""
