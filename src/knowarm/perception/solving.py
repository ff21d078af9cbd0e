"""See, then solve: the grasp frame that a network sees, and inverse kinematics to it; no policy.

It needs what a policy does without: joint angles and a kinematic model of the arm.
"""

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from knowarm.arrays import Floats, Integers
from knowarm.errors import UserError
from knowarm.perception.agent import FrameRecognition
from knowarm.policy import PolicyAgent
from knowarm.world.agents.protocol import Batch
from knowarm.world.config import EnvConfig, scene_of
from knowarm.world.tasks.skills.ik import InverseKinematics
from knowarm.world.tasks.state import nearest_levels


class SolvingAgent:
    """Moves every joint straight to its angle at the frame that is seen in the first image.

    Args:
        agent: the agent whose recognition sees; its policy plays no part.
        env: robot and task.

    Attributes:
        notes: those of ``agent``.

    Raises:
        UserError: the agent has no recognition of frames, or the arm moves more than its joints.
    """

    notes: dict[str, np.ndarray]

    def __init__(self, agent: PolicyAgent, env: EnvConfig) -> None:
        if not isinstance(agent.recognition, FrameRecognition):
            raise UserError(
                "Only what sees a grasp frame can solve the way to it: this agent has no "
                "grounding network. Take a run such as zoo/irb120-choose-answers-fast."
            )
        scene = scene_of(env)
        if scene.joint_names != scene.robot.joints:
            raise UserError(
                f"The way to a grasp frame does not tell what else moves in {env.task.name}: "
                "solving is for skills that reach a pose."
            )
        self._agent = agent
        self._network = agent.recognition.network
        self._solver = InverseKinematics.within_angle(
            scene, env.success_angle_deg, env.ignore_roll
        )

    @property
    def depends_on_rows(self) -> bool:
        """Whether episodes of different queries differ."""
        return self._agent.depends_on_rows

    def reset(self, batch: Batch) -> None:
        """Forget everything: n episodes start."""
        self._agent.reset(batch)
        self.notes = {}
        self._start = np.stack(list(batch.joints.values()), axis=1)
        self._step = batch.increments.max()
        self._goal: Floats | None = None

    def act(self, observations: Mapping[str, np.ndarray]) -> Integers:
        """Choose the action of each joint that ends nearest to its solution, (n, J)."""
        if self._goal is None:
            images = torch.from_numpy(observations["image"].copy())
            frames = self._agent.recognize(images)
            self.notes = self._agent.notes
            position, matrix = self.poses(frames)
            self._goal = self._solver.solve(position, matrix, self._start).joints
        return nearest_levels((self._goal - observations["joint_targets"]) / self._step)

    def poses(self, frames: Tensor) -> tuple[Floats, Floats]:
        """Return the poses of frames (n, 9): (n, 3) [m], and row-major rotations (n, 9)."""
        position = frames[:, :3] * self._network.position_std
        position += self._network.position_mean
        x, z = frames[:, 3:].double().unflatten(1, (2, 3)).unbind(1)
        z = torch.nn.functional.normalize(z)
        x = torch.nn.functional.normalize(x - (x * z).sum(1, keepdim=True) * z)
        matrix = torch.stack([x, torch.linalg.cross(z, x), z], dim=2)
        return position.double().numpy(), matrix.flatten(1).numpy()
