"""Sampling of objects: what a task draws episodes from, one object per episode, the draws.

Random numbers are counter-based: a draw is a hash of stream, episode and draw number, so any
episodes of any streams can be drawn in one batch, in any order, and the state of a stream is two
integers. The hash is splitmix64's finalizer (Steele, Lea and Flood 2014) applied to each in turn.
"""

from dataclasses import dataclass
from itertools import chain
from typing import Literal, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from knowarm.arrays import Floats, Indices, Integers, Mask, Names
from knowarm.errors import UserError
from knowarm.questions import ObjectColour, number_parts
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.held_out import (
    TRIES,
    HeldOut,
    allowed_colours,
    check_names,
    choose_places,
)

Colours = Literal["fixed", "randomized"]

Facets = tuple[ObjectColour, ...]
"""The (object, colour) pairs that can be shown; objects in config order."""

_TARGET, _X, _Y, _COLOUR = range(4)  # order of the first draws of an episode


class Setting(NamedTuple):
    """What a task draws episodes from."""

    scene: Scene
    """Robot and objects."""
    colours: Colours
    """Always an object's first colour, or one of its colours drawn per episode."""
    held_out: HeldOut | None
    """Colours and places reserved for a test of generalization."""
    facets: Facets
    """What can be shown."""


class DrawnObjects(NamedTuple):
    """Objects of n episodes, the one to reach first; fields as those of ``Episodes``."""

    objects: Integers
    colours: Integers
    positions: Floats
    question: Names


@dataclass(frozen=True)
class Episodes:
    """Start conditions of n episodes, drawn before they are played; a fixed test set is a value.

    m objects are visible; the first is the one to reach.
    """

    joint_offsets: Floats
    """Start angle of each joint relative to home [rad], (n, J)."""
    objects: Integers
    """Indices of the visible objects into the config's targets, (n, m)."""
    colours: Integers
    """Indices into the colours of these, (n, m)."""
    positions: Floats
    """x and y of these [m], (n, m, 2)."""
    question: Names
    """Query that the episode asks, (n,), as "usedFor drinking"; empty without questions."""
    look: Floats
    """Uniform draws for the visual randomization, (n, L); L = 0 without any."""
    names: Names
    """Names of the visible objects, (n, m): ``objects`` counts in the order of one config."""
    surroundings: Floats
    """Uniform draws for what else the skill puts into the scene, (n, S); S = 0 for most."""

    @property
    def target(self) -> Integers:
        """Index of the object to reach, (n,)."""
        return self.objects[:, 0]

    @property
    def colour(self) -> Integers:
        """Index into its colours, (n,)."""
        return self.colours[:, 0]

    @property
    def position(self) -> Floats:
        """Its x and y [m], (n, 2)."""
        return self.positions[:, 0]

    def __len__(self) -> int:
        return len(self.objects)

    def __getitem__(self, index: slice | Indices | Mask) -> Self:
        """Select episodes by a slice or an index array."""
        return type(self)(*[values[index] for values in vars(self).values()])


class ObjectSampler(Protocol):
    """Draws the objects of episodes.

    Attributes:
        draws: number of uniform draws per episode besides the first four.
    """

    draws: int

    def __call__(self, first: Floats, more: Floats) -> DrawnObjects:
        """Draw the objects of n episodes.

        Args:
            first: uniform draws in [0, 1) for object, x, y and colour, (n, 4).
            more: further ones, (n, ``draws``).
        """


class OneObject:
    """Draws one object per episode, uniform in object, position in the rectangle and colour."""

    def __init__(self, setting: Setting) -> None:
        robot = setting.scene.robot
        held_out = setting.held_out
        if number_parts(setting.facets).shape[1] > 1:
            raise UserError(
                "EnvConfig.targets names several parts of one object, and this task shows one "
                "object with one grasp. Name one part per object, or ask for parts."
            )
        self._targets = len(setting.scene.targets)
        self._held_out = held_out
        self._centre = np.array(robot.rectangle_centre_m)
        self._half = np.array(robot.rectangle_half_size_m)
        self._colours, self._colour_count = _allowed_colours(setting)
        self.draws = 2 * TRIES if held_out and held_out.places else 0

    def __call__(self, first: Floats, more: Floats) -> DrawnObjects:
        """Draw the objects of n episodes; ``more`` are further candidates for the position."""
        n = len(first)
        target = (first[:, _TARGET] * self._targets).astype(np.int64)
        candidates = np.concatenate([first[:, _X : _Y + 1], more], axis=1)
        signed = 2 * candidates.reshape(n, 1 + self.draws // 2, 2) - 1
        shade = (first[:, _COLOUR] * self._colour_count[target]).astype(np.int64)
        position = self._centre + choose_places(self._held_out, signed) * self._half
        return DrawnObjects(
            objects=target[:, None],
            colours=self._colours[target, shade][:, None],
            positions=position[:, None],
            question=np.full(n, ""),
        )


def _allowed_colours(setting: Setting) -> tuple[Integers, Integers]:
    """Return the allowed colour indices of each target, (K, C), and their number, (K,)."""
    scene = setting.scene
    last = None if setting.colours == "randomized" else 1
    shades = [names[:last] for names in scene.colour_names]
    check_names(setting.held_out, list(chain.from_iterable(shades)))
    count = np.zeros(len(shades), np.int64)
    table = np.zeros((len(shades), max(map(len, shades))), dtype=np.int64)
    for k, target in enumerate(scene.targets):
        indices = allowed_colours(setting.held_out, shades[k], target.name)
        count[k] = len(indices)
        table[k, : count[k]] = indices
    return table, count


Words = NDArray[np.uint64]

_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)


def uniforms(streams: Words, episodes: Words, count: int) -> Floats:
    """Draw ``count`` uniforms in [0, 1) for each stream's seed and episode's number, (n, count)."""
    key = _mix(_mix(streams) ^ episodes)
    draws = np.arange(count, dtype=np.uint64)
    bits = _mix(key[:, None] ^ _mix(draws)[None, :])
    return (bits >> np.uint64(11)).astype(np.float64) * 2.0**-53


def derive(seed: int, label: str) -> int:
    """Derive a 64-bit seed that is unrelated to the streams seed, seed + 1, ... for a purpose."""
    digest = np.array([seed % 2**64], np.uint64)
    for byte in label.encode():
        digest = _mix(digest ^ np.uint64(byte))
    return int(digest[0])


def _mix(x: Words) -> Words:
    """Add the golden gamma and apply splitmix64's finalizer, modulo 2**64."""
    x = x + _GAMMA
    x = (x ^ (x >> np.uint64(30))) * _MIX_1
    x = (x ^ (x >> np.uint64(27))) * _MIX_2
    return x ^ (x >> np.uint64(31))
