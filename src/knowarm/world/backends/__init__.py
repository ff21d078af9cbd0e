"""Physics: MuJoCo on a pool of CPU threads. Importing this package imports no simulator."""
