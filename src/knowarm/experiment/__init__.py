"""Experiments: registries of agents and algorithms, training runs, evaluations and run folders.

`agents` and `algorithms` are the registries; `registry` combines them with the robots to named
experiments (`config.ExperimentConfig`). `build` makes the parts of an experiment, `run` trains it
in a `run_folder` with its `logs`, `load` reads the trained agent back and `evaluate` measures it.
`migration` reads run folders of the older format.
"""
