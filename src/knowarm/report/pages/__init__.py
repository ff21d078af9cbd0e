"""Pages of the report: the blocks of each, for one task or for the whole study."""
