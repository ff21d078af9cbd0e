"""KnowArm-Bench: frozen suites of episodes, on which any policy is scored beside its controls."""
