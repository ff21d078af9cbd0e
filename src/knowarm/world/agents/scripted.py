"""Agents that act by a fixed rule (zero, random, list, oracle), and agents that see less."""

from collections.abc import Callable
from typing import ClassVar

import numpy as np

from knowarm.arrays import Images, Integers
from knowarm.world.agents.protocol import (
    AgentProtocol,
    Batch,
    Observations,
    PrivilegedAgent,
)
from knowarm.world.config import EnvConfig, scene_of
from knowarm.world.envs.running import joint_increments
from knowarm.world.envs.single_env import ArmEnv
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.skills.guides import Guide, JointPath, Sight
from knowarm.world.tasks.state import ACTION_LEVELS, nearest_levels


class _UninformedAgent:
    """Base of agents that use nothing but the shape of the actions."""

    inputs: ClassVar[tuple[str, ...]] = ()

    def reset(self, batch: Batch) -> None:
        """Read the shape of the actions."""
        self._shape = (batch.size, len(batch.joints))


class ZeroAgent(_UninformedAgent):
    """Never moves."""

    def act(self, observations: Observations) -> Integers:
        """Return the action without movement, (n, J)."""
        return np.zeros(self._shape, np.int64)


class RandomAgent(_UninformedAgent):
    """Draws every action uniformly; a trained agent has to be better than this."""

    def __init__(self, seed: int = 0) -> None:
        self._generator = np.random.default_rng(seed)

    def act(self, observations: Observations) -> Integers:
        """Draw actions (n, J)."""
        return self._generator.integers(len(ACTION_LEVELS), size=self._shape)


class OpenLoopAgent(_UninformedAgent):
    """Plays a fixed list of actions (T, J) in every episode."""

    def __init__(self, actions: Integers) -> None:
        self._actions = actions

    def reset(self, batch: Batch) -> None:
        """Return to the beginning of the list."""
        super().reset(batch)
        self._step = 0

    def act(self, observations: Observations) -> Integers:
        """Return the next action for every environment, (n, J)."""
        action = self._actions[self._step]
        self._step += 1
        return np.tile(action, (self._shape[0], 1))


class OracleAgent(PrivilegedAgent):
    """Moves to the true goal frame by inverse kinematics, without looking at the image.

    In every step each joint takes the action that ends nearest to the path of the skill's guide
    (`Skill.guide`). It shows that a task can be solved with the seven actions, and its score is an
    upper reference for agents that see images.

    Attributes:
        guide: solves the paths.
        path: those of the running episodes.
    """

    path: JointPath
    _straight = False  # Whether the path ends straight along the approach direction

    def __init__(self, env: ArmEnv | ArmVectorEnv, seed: int = 0) -> None:
        super().__init__(env, seed)
        self.guide = guide_of(self._env.config, seed, self._straight)

    def reset(self, batch: Batch) -> None:
        """Solve the inverse kinematics of every episode."""
        super().reset(batch)
        self.path = self.guide.path(Sight.true(self._env.running))

    def act(self, observations: Observations) -> Integers:
        """Choose for each joint the action that ends nearest to its solution, (n, J)."""
        return nearest_levels(self.path.error(self._env.running.joint_targets))


def guide_of(env: EnvConfig, seed: int = 0, straight: bool = False) -> Guide:
    """Make the guide of a task's episodes; ``straight`` as in `Skill.guide`."""
    scene = scene_of(env)
    kind = env.task.skill.guide(straight)
    largest_step = float(joint_increments(scene.robot, env).max())
    return kind(scene, largest_step, env.success_angle_deg, env.ignore_roll, seed)


class ApproachAgent(OracleAgent):
    """Moves to the true goal frame along its approach direction, as a gripper has to."""

    _straight = True


class TeacherAgent(PrivilegedAgent):
    """Acts as the teacher of imitation says, at all levels.

    Its success tells where a student has something to learn from.
    """

    def __init__(self, env: ArmEnv | ArmVectorEnv, seed: int = 0) -> None:
        super().__init__(env, seed)
        self.teacher = self._env.config.task.skill.teacher(self._env.running)

    def act(self, observations: Observations) -> Integers:
        """Choose for each joint the action that ends nearest to what the teacher says, (n, J)."""
        return nearest_levels(self.teacher.error())


class InformedAgent:
    """Plays an agent on changed queries or knowledge of the episodes.

    Args:
        agent: what plays.
        change: changes the batch that the agent is reset with.
    """

    def __init__(
        self,
        agent: AgentProtocol,
        change: Callable[[Batch], Batch] = lambda batch: batch,
    ) -> None:
        self._agent = agent
        self._change = change

    def reset(self, batch: Batch) -> None:
        """Reset the agent with a changed batch."""
        self._agent.reset(self._change(batch))

    def act(self, observations: Observations) -> Integers:
        """Choose actions (n, J)."""
        return self._agent.act(observations)


class BlindAgent(InformedAgent):
    """Plays an agent, which keeps its memory and its knowledge, on black images."""

    def act(self, observations: Observations) -> Integers:
        """Choose actions (n, J) for black images."""
        black = np.zeros_like(observations["image"])
        return super().act({**observations, "image": black})


class FrozenAgent(InformedAgent):
    """Plays an agent that sees the first image of an episode in every step."""

    def reset(self, batch: Batch) -> None:
        """Reset the agent and forget the images."""
        super().reset(batch)
        self._first: Images | None = None

    def act(self, observations: Observations) -> Integers:
        """Choose actions (n, J) for the first images since the reset."""
        if self._first is None:
            self._first = observations["image"].copy()
        return super().act({**observations, "image": self._first})
