"""Graphs: triples, names, subgraphs, statistics and SPARQL."""
