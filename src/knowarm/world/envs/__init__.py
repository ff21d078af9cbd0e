"""Environments: NumPy vector, torch vector and single; arguments and wrappers."""
