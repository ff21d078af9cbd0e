"""Queries of a graph: which there are, splits for studies, and what these hold out."""
