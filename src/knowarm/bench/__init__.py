"""Benchmarks of the user's own machine: simulation, training, and both on a GPU.

Comparisons with other libraries are scripts in the repository's ``benchmarks/`` folder.
"""
