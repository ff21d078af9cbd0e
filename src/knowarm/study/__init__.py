"""Studies: a table of training runs, executed on one machine or a cluster and restartable.

`config` is a study as data and `shipped` holds the named ones. `status` derives the state of every
run from its folder, `worker` trains and evaluates one run in a process of its own, `driver` starts
the workers through one of the `executors`, `estimate` predicts their cost, `pack` turns a study
into one file, and `mirrors` send curves to tracking services.
"""
