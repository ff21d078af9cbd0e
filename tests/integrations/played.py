"""Plays a runner, or anything with its methods, in the simulator."""

import numpy as np

from knowarm.world.envs.running import joint_increments
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.state import ACTION_LEVELS


class RunnerAgent:
    """Plays a runner in one environment and checks that both have the same targets."""

    def __init__(self, start, step, joint_names):
        self.begin, self.step, self.joint_names = start, step, joint_names

    def start(self, env: ArmVectorEnv) -> None:
        self.env = env
        self.increments = joint_increments(env.scene.robot, env.config)
        joints = dict(zip(self.joint_names, env.joint_positions[0].tolist(), strict=True))
        self.begin(joints, int(env.knowledge_input[0]))

    def act(self, images):
        before = self.env.joint_targets[0]
        change = np.asarray(self.step(images[0])) - before
        lower, upper = self.env.scene.joint_lower, self.env.scene.joint_upper
        reached = (before[:, None] + self.increments).clip(lower[:, None], upper[:, None]) - before[
            :, None
        ]
        error = np.abs(change[:, None] - reached)
        assert error.min(1).max() < 1e-9, "the targets of runner and simulator differ"
        return error.argmin(1)[None]


assert len(ACTION_LEVELS) == 7
