"""Episodes as data: how they start, and how they are drawn from streams of random numbers."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from knowarm.world.arrays import Array, Place, array_namespace, here
from knowarm.world.choice_source import ChoiceSource, Chosen
from knowarm.world.config import EnvConfig
from knowarm.world.draws import derive, uniforms
from knowarm.world.held_out import TRIES, allowed_colours, check_names, choose_places
from knowarm.world.scene import Scene

_TARGET, _X, _Y, _COLOUR, _JOINTS = range(5)  # order of an episode's draws


@dataclass(frozen=True)
class Episodes:
    """Start conditions of n episodes, drawn before they are played; a fixed test set is a value.

    On a GPU the fields are torch tensors of the same shapes and dtypes.
    """

    joint_offsets: NDArray[np.float64]
    """Start angle of each joint relative to home [rad], (n, J)."""

    target: NDArray[np.int64]
    """Index into the config's targets, (n,)."""

    position: NDArray[np.float64]
    """x and y of the target [m], (n, 2)."""

    colour: NDArray[np.int64]
    """Index into the target's colours, (n,)."""

    look: NDArray[np.float64]
    """Uniform draws for the visual randomization, (n, L); L = 0 without any."""

    others: NDArray[np.int64]
    """Indices of the other visible objects into the config's targets, (n, M); M = 0 in reaching."""

    other_colour: NDArray[np.int64]
    """Indices into the colours of these, (n, M)."""

    other_position: NDArray[np.float64]
    """x and y of these [m], (n, M, 2)."""

    query: NDArray[np.int64]
    """Number of the query that means the target, (n,); 0 in reaching."""

    def __len__(self) -> int:
        return len(self.target)

    def __getitem__(self, index: slice | NDArray[np.intp] | NDArray[np.bool_]) -> "Episodes":
        """Select episodes by a slice or an index array."""
        return Episodes(*(getattr(self, field.name)[index] for field in fields(self)))


class EpisodeSource:
    """Draws the episodes of a scene and config by stream and number (paper, table 1).

    Target, position in the rectangle and colour are uniform; the start joints are uniform within
    +-start_fraction of half their range around home.

    Args:
        scene: the robot and targets.
        config: colours, held-out values and visual randomization.
        place: moves the constants to the device of the draws.

    Raises:
        UserError: held-out colours that no target has, or that leave a target without colour; a
            choice table that does not fit the targets.
    """

    def __init__(self, scene: Scene, config: EnvConfig, place: Place = here) -> None:
        robot = scene.robot
        self._joints = scene.num_joints
        self._targets = len(scene.targets)
        self._look_draws = config.randomization.draws
        self._held_out = config.held_out
        self._centre = place(np.array(robot.rectangle_centre_m))
        self._half = place(np.array(robot.rectangle_half_size_m))
        moved = np.isin(np.arange(scene.num_joints), robot.start_joints)
        self._moved = place(moved)
        self._reach = place(robot.start_fraction * (scene.joint_upper - scene.joint_lower) / 2)
        self._choices = ChoiceSource(scene, config, place) if config.choice else None
        table, count = _allowed_colours(scene, config)
        self._colours, self._colour_count = place(table), place(count)

    def __call__(self, streams: Array, indices: Array) -> Episodes:
        """Draw episodes.

        Args:
            streams: seed of each episode's stream, (n,) uint64, or int64 with the same bits.
            indices: number of the episode in its stream, (n,), same dtype.

        Returns:
            n episodes, as arrays of the same library. An episode depends on its two numbers only,
            not on n or the device.
        """
        xp = array_namespace(streams, indices)
        looks = _JOINTS + self._joints
        rest = looks + self._look_draws
        tries = TRIES if self._held_out and self._held_out.places else 0
        more = self._choices.draws if self._choices else 2 * tries
        u = uniforms(streams, indices, rest + more)
        offsets = xp.where(self._moved, (2 * u[:, _JOINTS:looks] - 1) * self._reach, 0.0)
        if self._choices:
            chosen = self._choices(u[:, _TARGET], u[:, rest:])
        else:
            chosen = self._one_object(u, u[:, rest:])
        return Episodes(joint_offsets=offsets, look=u[:, looks:rest], **chosen._asdict())

    def _one_object(self, u: Array, more: Array) -> Chosen:
        """Draw a target, its position and its colour; ``more`` are candidates for the position."""
        xp = array_namespace(u)
        n = u.shape[0]
        target = xp.astype(u[:, _TARGET] * self._targets, xp.int64)
        candidates = xp.concat([u[:, _X : _Y + 1], more], axis=1)
        signed = 2 * xp.reshape(candidates, (n, candidates.shape[1] // 2, 2)) - 1
        choice = xp.astype(u[:, _COLOUR] * self._colour_count[target], xp.int64)
        return Chosen(
            target=target,
            position=self._centre + choose_places(self._held_out, signed) * self._half,
            colour=self._colours[target, choice],
            others=xp.empty_like(target[:, None])[:, :0],
            other_colour=xp.empty_like(target[:, None])[:, :0],
            other_position=xp.empty_like(signed[:, :0]),
            query=xp.zeros_like(target),
        )


def draw_episodes(
    scene: Scene, config: EnvConfig, streams: NDArray[np.uint64], indices: NDArray[np.uint64]
) -> Episodes:
    """Draw episodes of a scene and config; see ``EpisodeSource``."""
    return EpisodeSource(scene, config)(streams, indices)


def _allowed_colours(
    scene: Scene, config: EnvConfig
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the allowed colour indices of each target, (K, C), and their number, (K,)."""
    every = [names if config.colours == "randomized" else names[:1] for names in scene.colour_names]
    check_names(config.held_out, [name for names in every for name in names])
    allowed = [
        allowed_colours(config.held_out, names, one.name)
        for names, one in zip(every, scene.targets, strict=True)
    ]
    table = np.zeros((len(allowed), max(map(len, allowed))), dtype=np.int64)
    for k, indices in enumerate(allowed):
        table[k, : len(indices)] = indices
    return table, np.array([len(indices) for indices in allowed])


def evaluation_episodes(scene: Scene, config: EnvConfig, count: int, seed: int) -> Episodes:
    """Draw a fixed list of episodes, none of which is part of a training stream.

    Args:
        scene: the robot and targets.
        config: the task.
        count: number of episodes.
        seed: seed of the list; a shorter list is the beginning of a longer one.
    """
    streams = np.full(count, derive(seed, "evaluation"), dtype=np.uint64)
    return draw_episodes(scene, config, streams, np.arange(count, dtype=np.uint64))
