"""Triples go in; a vector for every entity and relation comes out."""
