"""Interface of everything that plays: `AgentProtocol`, and what it learns as episodes start."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import ClassVar, Protocol, Self

import numpy as np

from knowarm.arrays import Array, Floats, Integers, Names
from knowarm.errors import UserError
from knowarm.questions import find_rows
from knowarm.world.config import EnvConfig, questions_of, row_names, scene_of
from knowarm.world.envs.running import joint_increments
from knowarm.world.envs.single_env import ArmEnv, vector_of
from knowarm.world.envs.vector_env import ArmVectorEnv

INPUTS = ("image", "words", "graph", "simulator")
"""What an agent may use: the image, the query's words, a graph, the simulator's state."""

Observations = Mapping[str, Array]


@dataclass(frozen=True, kw_only=True)
class Batch:
    """What an agent may know when n episodes start; the simulator's state is not part of it."""

    env: EnvConfig
    """Robot and task."""
    names: Names
    """Facet or query of each episode, as the info ``task.asked.knowledge_info`` gives it, (n,)."""
    joints: Mapping[str, Floats] = field(default_factory=dict)
    """Start angle of each joint by name, (n,) [rad] (slides: [m])."""
    graph: Collection[tuple[str, str, str]] | None = None
    """Triples that replace the agent's own graph in these episodes."""
    facts: Mapping[str, Array] = field(default_factory=dict)
    """What else the task gives of each episode, (n, ...); see `Skill.facts`."""
    own_rows: Integers | None = None
    """Rows of an agent whose knowledge is given per episode, (n,); None: those of the names."""

    @classmethod
    def of(cls, env: ArmVectorEnv) -> Self:
        """Describe the episodes that have just started in an environment."""
        names = np.array(row_names(env.config))[env.knowledge_input]
        joints = dict(
            zip(env.scene.joint_names, env.joint_positions.T.copy(), strict=True)
        )
        task = env.config.task
        facts = task.skill.facts(env.running, task.asked)
        return cls(env=env.config, names=names, joints=joints, facts=facts)

    @property
    def size(self) -> int:
        """Number of episodes n, which are played side by side."""
        return len(self.names)

    @property
    def rows(self) -> Integers:
        """Row of each episode's facet or query among ``task.asked.knowledge_rows``, (n,)."""
        if self.own_rows is not None:
            return self.own_rows
        rows = {name: row for row, name in enumerate(row_names(self.env))}
        return find_rows(self.env.task.asked.knowledge_info, self.names, rows)

    @property
    def queries(self) -> tuple[str, ...] | None:
        """Query of each episode, such as ``usedFor drinking and hasColor blue``, or None."""
        if questions_of(self.env) is None:
            return None
        return tuple(self.names.tolist())

    @property
    def conditions(self) -> tuple[tuple[tuple[str, str], ...], ...] | None:
        """The queries as (relation, value) pairs."""
        table = questions_of(self.env)
        if table is None:
            return None
        pairs = []
        for row in self.rows:
            conditions = table.queries[row].conditions
            pairs.append(tuple((part.relation, part.value) for part in conditions))
        return tuple(pairs)

    @property
    def increments(self) -> Floats:
        """Joint increment of each of the seven levels, (7,) [rad]."""
        return joint_increments(scene_of(self.env).robot, self.env)

    @property
    def limits(self) -> Floats:
        """Lower and upper limits of the joints, (2, J) [rad]."""
        scene = scene_of(self.env)
        return np.stack([scene.joint_lower, scene.joint_upper])


class AgentProtocol(Protocol):
    """What plays: scripted, trained, exported, served, or of anybody.

    The n episodes of a batch start together. Where one has ended, its actions are ignored until the
    next ``reset``. What an agent reports of its episodes beside actions may be in ``notes``, arrays
    (n, ...) by name, which `play` keeps in its result.
    """

    def reset(self, batch: Batch) -> None:
        """Forget everything: n new episodes start."""

    def act(self, observations: Observations) -> Integers:
        """Choose actions (n, J), levels 0 to 6 of each joint.

        ``observations["image"]`` is (n, H, W, 3) uint8 RGB, ``observations["joint_targets"]`` the
        joint angles that the actions have commanded, (n, J) float32 [rad].
        """


class PrivilegedAgent:
    """Base of agents that use the simulator's state: each is made for one environment.

    Args:
        env: the environment that the agent plays, vector or single.
        seed: of what it draws.
    """

    inputs: ClassVar[tuple[str, ...]] = ("simulator",)
    """What the agent uses, of `INPUTS`."""

    def __init__(self, env: ArmEnv | ArmVectorEnv, seed: int = 0) -> None:
        self._env = vector_of(env)
        self._seed = seed

    def reset(self, batch: Batch) -> None:
        """Check that the episodes are those of the environment.

        Raises:
            UserError: they started in another one.
        """
        if not np.array_equal(list(batch.joints.values()), self._env.joint_positions.T):
            raise UserError(
                f"This {type(self).__name__} was made for another environment; make one for this."
            )

    def act(self, observations: Observations) -> Integers:
        """Choose actions, as `AgentProtocol`."""
        raise NotImplementedError
