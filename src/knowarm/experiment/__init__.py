"""Experiments: registries of agents and algorithms, training runs, evaluations and run folders.

`agents` and `algorithms` are the registries; `names` combines them with the robots to named
experiments (`config.ExperimentConfig`). `build` makes the parts of an experiment, `run` trains it
in a `run_folder` with its `logs`, `load` loads the agent, and `evaluate` measures it.
"""
