"""Policies for `knowarm benchmark run reach-v1 --policy my_policy:Random`."""

import numpy as np


class Random:
    """Draws every action; a policy is any class with reset and act."""

    inputs = ()  # what it uses: "image", "words", "graph", "simulator"
    training = "none"

    def reset(self, batch):
        """Read how many episodes start, at which joint angles, and what is asked."""
        self.shape = (batch.size, len(batch.joints))
        self.generator = np.random.default_rng(0)

    def act(self, observations):
        """Choose one of seven levels per joint."""
        return self.generator.integers(7, size=self.shape)
