"""Plays a runner, or anything with its methods, in the simulator."""

import numpy as np


class RunnerAgent:
    """Plays a runner in one environment and checks that both have the same targets."""

    def __init__(self, start, step, joint_names):
        self.begin, self.step, self.joint_names = start, step, joint_names

    def reset(self, batch):
        self.increments, self.limits = batch.increments, batch.limits
        joints = {name: float(batch.joints[name][0]) for name in self.joint_names}
        self.begin(joints, int(batch.rows[0]))

    def act(self, observations):
        before = observations["joint_targets"][0]
        change = np.asarray(self.step(observations["image"][0])) - before
        lower, upper = self.limits
        reached = (before[:, None] + self.increments).clip(lower[:, None], upper[:, None]) - before[
            :, None
        ]
        error = np.abs(change[:, None] - reached)
        assert error.min(1).max() < 1e-6, "the targets of runner and simulator differ"
        return error.argmin(1)[None]
