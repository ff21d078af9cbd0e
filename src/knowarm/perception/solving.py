"""Agents that act on all that a network sees: object, grasp frame, and where it has to be put.

See, then solve: `SolvingAgent` moves on a path that a guide solves, without a policy. It needs what
a policy does without: joint angles and a kinematic model of the arm. `PlacingAgent` tells a policy
the destination.
"""

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Self

import numpy as np
import torch
from torch import Tensor

from knowarm.arrays import Floats, Integers, Mask
from knowarm.errors import UserError
from knowarm.perception.grounding import BATCH
from knowarm.perception.recognition import AnsweringAgent, FrameRecognition
from knowarm.policy import PolicyAgent
from knowarm.world.agents.protocol import Batch
from knowarm.world.agents.scripted import guide_of
from knowarm.world.config import EnvConfig, scene_of
from knowarm.world.tasks.skills.guides import DESTINATION, Sight
from knowarm.world.tasks.state import nearest_levels


class Seen(NamedTuple):
    """What a network names in n images, m objects each."""

    facets: Integers
    """Numbers among those of the network, (n, m)."""
    objects: Integers
    """Numbers of the objects in the scene, (n, m)."""
    position: Floats
    """Points that the gripper has to reach, world, (n, m, 3) [m]."""
    matrix: Floats
    """Rotations from goal frame to world, row-major, (n, m, 9)."""
    places: Floats
    """x and y of the objects, (n, m, 2) [m]."""


class SeeingAgent(ABC):
    """Base of agents that act on what is seen in the first image.

    Args:
        agent: the agent whose recognition sees.
        env: robot and task.
        graph: the `KnowledgeGraph` that says where objects belong; None: it does not know.
        guesses: whether it moves where that does not say where the object belongs.
        hears: whether it is told the destination that a question names.
        swaps: whether it is told wrong facts, by which the object belongs elsewhere; a control.

    Attributes:
        agent: the agent whose recognition sees.
        notes: those of ``agent``.
        lacks_place: where it stays, since it does not know where the object belongs, (n,).

    Raises:
        UserError: the agent has no recognition of frames.
    """

    notes: dict[str, np.ndarray]

    def __init__(
        self,
        agent: PolicyAgent,
        env: EnvConfig,
        graph: Any = None,
        *,
        guesses: bool = True,
        hears: bool = True,
        swaps: bool = False,
    ) -> None:
        if not isinstance(agent.recognition, FrameRecognition):
            raise UserError(
                "Only what sees a grasp frame can act on it: this agent has no grounding network. "
                "Take a run such as zoo/irb120-choose-answers-fast."
            )
        self.agent = agent
        self._recognition = agent.recognition
        self._network = agent.recognition.network
        self._recognition.check_fits(env)
        self._skill = env.task.skill
        self._graph = graph
        self._guesses = guesses
        self._hears = hears
        self._swaps = swaps
        self._scene = scene_of(env)
        names = [target.name for target in self._scene.targets]
        facets = self._network.spec.facets
        self._object_of = np.array([names.index(name) for name, _ in facets])

    @property
    def depends_on_rows(self) -> bool:
        """Whether episodes of different queries differ."""
        return self.agent.depends_on_rows

    @property
    def told(self) -> Tensor:
        """As `PolicyAgent.told`."""
        return self.agent.told

    def telling(self, rows: Sequence[Tensor]) -> Self:
        """As `PolicyAgent.telling`."""
        agent = copy.copy(self)
        agent.agent = self.agent.telling(rows)
        return agent

    @property
    def moves(self) -> Mask:
        """Whether the arm moves in each environment, (n,) bool."""
        moves = np.ones(len(self._joints), bool)
        if isinstance(self.agent, AnsweringAgent):
            moves = self.agent.moves
        return moves & ~self.lacks_place

    def reset(self, batch: Batch) -> None:
        """Forget everything: n episodes start.

        Raises:
            UserError: the batch lacks the facts of the episodes.
        """
        if self._skill.tells_facts and not batch.facts:
            raise UserError(
                "Where an object belongs follows from facts of the episode, which are not given: "
                "play this agent by `knowarm.play`, `evaluate`, `ask`, `view` or `record`."
            )
        self.agent.reset(batch)
        self.notes = {}
        self._joints = np.zeros((batch.size, 0))
        if batch.joints:
            self._joints = np.stack(list(batch.joints.values()), axis=1)
        self._facts = dict(batch.facts)
        if not self._hears:
            self._facts.pop(DESTINATION, None)
        if self._swaps:
            self._facts |= self._skill.swapped(self._facts)
        self.lacks_place = np.zeros(batch.size, bool)
        self._has_looked = False

    def act(self, observations: Mapping[str, np.ndarray]) -> Integers:
        """Choose actions (n, J); 0, which adds nothing to the joint targets, where it stays."""
        if not self._has_looked:
            images = torch.from_numpy(observations["image"].copy())
            frames = self.agent.recognize(images)
            self.notes = self.agent.notes
            sight = self._sight(images, frames)
            if sight.decided is not None and not self._guesses:
                self.lacks_place = ~sight.decided
            self._plan(sight, frames)
            self._has_looked = True
        actions = self._choose(observations)
        return np.where(self.moves[:, None], actions, 0)

    @abstractmethod
    def _plan(self, sight: Sight, frames: Tensor) -> None:
        """Take in what is seen as n episodes start; ``frames`` (n, 9) are the goal frames."""

    @abstractmethod
    def _choose(self, observations: Mapping[str, np.ndarray]) -> Integers:
        """Choose actions (n, J)."""

    def _sight(self, images: Tensor, frames: Tensor) -> Sight:
        """Return what images show: the goal frames (n, 9), and all objects.

        The object that is meant is the one whose frame is nearest to the goal frame.
        """
        position, matrix = self.poses(frames)
        seen = self.look(images)
        distance = np.linalg.norm(seen.position - position[:, None], axis=2)
        order = np.argsort(distance, axis=1, kind="stable")
        objects = np.take_along_axis(seen.objects, order, axis=1)
        places = np.take_along_axis(seen.places, order[..., None], axis=1)
        sight = Sight(self._joints, position, matrix, objects, places)
        return self._skill.see(
            self._scene, sight, images.numpy(), self._facts, self._graph
        )

    def look(self, images: Tensor) -> Seen:
        """Name the objects in images (n, H, W, 3) uint8, surest first."""
        named = [self._recognition.look_around(batch) for batch in images.split(BATCH)]
        facets, around = (torch.cat(parts) for parts in zip(*named, strict=True))
        objects = self._object_of[facets.numpy()]
        shape = objects.shape
        position, matrix = self.poses(around.flatten(0, 1))
        position = position.reshape(*shape, 3)
        places = position[..., :2] - self._scene.grasp_position[objects, :2]
        matrix = matrix.reshape(*shape, 9)
        return Seen(facets.numpy(), objects, position, matrix, places)

    def poses(self, frames: Tensor) -> tuple[Floats, Floats]:
        """Return the poses of frames (n, 9): (n, 3) [m], and row-major rotations (n, 9)."""
        position = frames[:, :3] * self._network.position_std
        position += self._network.position_mean
        x, z = frames[:, 3:].double().unflatten(1, (2, 3)).unbind(1)
        z = torch.nn.functional.normalize(z)
        x = torch.nn.functional.normalize(x - (x * z).sum(1, keepdim=True) * z)
        matrix = torch.stack([x, torch.linalg.cross(z, x), z], dim=2)
        return position.double().numpy(), matrix.flatten(1).numpy()


class SolvingAgent(SeeingAgent):
    """Moves the arm on the path that the task's guide solves; the policy plays no part.

    Raises:
        UserError: as the base, or the task has no guide that moves all its joints.
    """

    def __init__(
        self, agent: PolicyAgent, env: EnvConfig, graph: Any = None, **options: Any
    ) -> None:
        super().__init__(agent, env, graph, **options)
        self._guide = guide_of(env)

    def reset(self, batch: Batch) -> None:
        """Forget everything: n episodes start.

        Raises:
            UserError: the batch does not tell the joint angles.
        """
        if not batch.joints:
            raise UserError(
                "An agent that sees and solves needs the arm's joint angles as episodes start: "
                "play it by `knowarm.play`, `evaluate`, `ask`, `view` or `record`."
            )
        super().reset(batch)

    def _plan(self, sight: Sight, frames: Tensor) -> None:
        self._path = self._guide.path(sight)

    def _choose(self, observations: Mapping[str, np.ndarray]) -> Integers:
        """Choose the action of each joint that ends nearest to the path, (n, J)."""
        return nearest_levels(self._path.error(observations["joint_targets"]))


class PlacingAgent(SeeingAgent):
    """Lets the policy act, which is told the destination that is seen beside the grasp frame."""

    def _plan(self, sight: Sight, frames: Tensor) -> None:
        assert sight.destination is not None
        destination = self._recognition.destinations(sight.destination)
        self.agent.knowledge = torch.cat([frames, destination], dim=1)

    def _choose(self, observations: Mapping[str, np.ndarray]) -> Integers:
        return self.agent.act(observations)


def player(
    agent: PolicyAgent,
    env: EnvConfig,
    graph: Any,
    *,
    solves: bool,
    **options: Any,
) -> PolicyAgent | SeeingAgent:
    """Return what acts for an agent in a task: inverse kinematics, or its policy.

    Args:
        agent: recognizes and, unless the path is solved, chooses actions.
        env: robot and task.
        graph: as `SeeingAgent`.
        solves: whether inverse kinematics act in place of the policy.
        options: further arguments of `SeeingAgent`.
    """
    if solves:
        return SolvingAgent(agent, env, graph, **options)
    if env.task.skill.tells_facts:
        return PlacingAgent(agent, env, graph, **options)
    return agent
