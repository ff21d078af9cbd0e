"""What others built goes in beside ours; one table of speeds, measured in one run, comes out."""
