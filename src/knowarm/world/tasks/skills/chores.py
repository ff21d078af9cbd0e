"""Chores: what there is to do with all objects of a scene, where a skill does it with one."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from knowarm.arrays import Floats, Images, Integers, Mask
from knowarm.knowledge import KnowledgeGraph
from knowarm.world.tasks.skills.guides import Guide
from knowarm.world.tasks.state import NamedArrays


@dataclass(frozen=True, kw_only=True)
class Tidied:
    """How n scenes with m objects stand."""

    belongs: Integers
    """Number of the place where each object belongs, or -1, (n, m)."""
    stands: Integers
    """Number of the place where it stands, or -1, (n, m)."""
    moved: Mask
    """Whether it has moved by 3 cm, toppled or fallen, (n, m)."""

    @property
    def in_place(self) -> Mask:
        """Whether each object that belongs somewhere stands there, (n, m)."""
        return (self.belongs >= 0) & (self.belongs == self.stands)

    @property
    def is_tidy(self) -> Mask:
        """Whether all of them do in a scene, (n,)."""
        is_out = (self.belongs >= 0) & ~self.in_place
        return np.asarray(~is_out.any(axis=1))

    @property
    def wrong_place(self) -> Mask:
        """Whether each object stands at another place than its own, (n, m)."""
        return (self.stands >= 0) & (self.stands != self.belongs)

    @property
    def disturbed(self) -> Mask:
        """Whether an object that should stay has moved, in each scene, (n,)."""
        return np.asarray((self.moved & (self.belongs < 0)).any(axis=1))


class Chores(Protocol):
    """n scenes, in which objects belong at places, one at each; see `Skill.chores`.

    Attributes:
        relation: of the graph that says where objects belong.
        told: what an agent is given about the scenes, (n, K) names: the ``places`` and their
            ``marks``.
        spots: where objects are put down, x and y of each place, (K, 2) [m].
        guide: solves the path of one object to its spot and back.
    """

    relation: str
    told: NamedArrays
    spots: Floats
    guide: Guide

    def seen(self, images: Images) -> Integers:
        """Return the number of the place of each given mark, (n, K), by the images."""

    def belongs(self, graph: KnowledgeGraph | None, objects: Integers) -> Mask:
        """Return at which of the given places objects belong, (n, m, K)."""

    def fits(self) -> Mask:
        """Return in which scenes one object belongs at each place, and others at none, (n,)."""

    def judge(self, graph: KnowledgeGraph) -> Tidied:
        """Compare how the scenes stand with where a graph says that objects belong."""

    def instruct(self, scene: int) -> str:
        """Return what is given about a scene in words, as "the red tray is the kitchen"."""


def only(belongs: Mask, numbers: Integers) -> Integers:
    """Return the number of the place of each object, -1 where it is none or several, (n, m).

    Args:
        belongs: (n, m, K), as `Chores.belongs`.
        numbers: of these places, (n, K).
    """
    which = belongs.argmax(axis=2)
    number = np.take_along_axis(numbers, which, axis=1)
    return np.where(belongs.sum(axis=2) == 1, number, -1)
