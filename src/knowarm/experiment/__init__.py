"""Experiments: registries of agents and algorithms, training runs, evaluations and run folders.

`agents` and `algorithms` are the registries; `registry` combines them with the robots to named
experiments (`config.ExperimentConfig`). `build` makes the parts of an experiment and loads trained
agents, `run` trains it in a `run_folder` with its `logs`, and `evaluate` measures the agent.
"""
