"""Command line: one module per command, and the only package that parses arguments."""
