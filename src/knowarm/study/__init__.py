"""Studies: a table of training runs, executed in parallel and restartable."""
