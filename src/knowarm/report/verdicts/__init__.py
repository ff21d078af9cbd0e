"""Verdicts of a report: what the differences between agents say, in both kinds of study."""
