"""Seeds go in; ``Episodes``, the start of each episode as plain arrays, come out."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from knowarm.world.arrays import Array, Place, array_namespace, here
from knowarm.world.config import EnvConfig
from knowarm.world.draws import derive, uniforms
from knowarm.world.held_out import TRIES, allowed_colours, check_names, choose_places
from knowarm.world.scene import Scene

_TARGET, _X, _Y, _COLOUR, _JOINTS = range(5)  # order of an episode's draws


@dataclass(frozen=True)
class Episodes:
    """Where n episodes start. Drawn first and played later, so a fixed set is just this.

    On a GPU the same fields hold torch tensors of the same shapes and dtypes.
    """

    joint_offsets: NDArray[np.float64]
    """Start angle of each joint relative to home [rad], (n, J)."""

    target: NDArray[np.int64]
    """Index into the config's targets, (n,)."""

    position: NDArray[np.float64]
    """Where the target stands, x and y [m], (n, 2)."""

    colour: NDArray[np.int64]
    """Index into the target's colours, (n,)."""

    look: NDArray[np.float64]
    """Uniform draws of what varies in the image, (n, L); L = 0 when nothing does."""

    def __len__(self) -> int:
        return len(self.target)

    def __getitem__(self, index: slice | NDArray[np.intp] | NDArray[np.bool_]) -> "Episodes":
        """Pick episodes by a slice or an index array."""
        return Episodes(*(getattr(self, field.name)[index] for field in fields(self)))


class EpisodeSource:
    """Draws the episodes of a scene and config by their numbers (paper, table 1).

    Target, place in the rectangle and colour are uniform; the start joints begin within
    +-start_fraction of half their range about home.

    Args:
        scene: the robot and targets.
        config: which colours and places are drawn, and how many draws the image takes.
        place: puts the constants where episodes will be drawn; on the CPU by default.

    Raises:
        UserError: held-out colours that no target has, or that leave a target none.
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
        table, count = _allowed_colours(scene, config)
        self._colours, self._colour_count = place(table), place(count)

    def __call__(self, streams: Array, indices: Array) -> Episodes:
        """Draw episodes.

        Args:
            streams: seed of each episode's stream, (n,) uint64, or int64 with the same bits.
            indices: number of the episode in its stream, (n,) likewise.

        Returns:
            n episodes, as arrays of the same library; the same numbers give the same episode at
            any n and on any device.
        """
        xp = array_namespace(streams, indices)
        looks = _JOINTS + self._joints
        places = looks + self._look_draws
        tries = TRIES if self._held_out and self._held_out.places else 0
        u = uniforms(streams, indices, places + 2 * tries)
        target = xp.astype(u[:, _TARGET] * self._targets, xp.int64)
        candidates = xp.concat([u[:, _X : _Y + 1], u[:, places:]], axis=1)
        signed = 2 * xp.reshape(candidates, (u.shape[0], 1 + tries, 2)) - 1
        position = self._centre + choose_places(self._held_out, signed) * self._half
        choice = xp.astype(u[:, _COLOUR] * self._colour_count[target], xp.int64)
        offsets = xp.where(self._moved, (2 * u[:, _JOINTS:looks] - 1) * self._reach, 0.0)
        return Episodes(
            offsets, target, position, self._colours[target, choice], u[:, looks:places]
        )


def draw_episodes(
    scene: Scene, config: EnvConfig, streams: NDArray[np.uint64], indices: NDArray[np.uint64]
) -> Episodes:
    """Draw episodes of a scene and config once; see ``EpisodeSource``."""
    return EpisodeSource(scene, config)(streams, indices)


def _allowed_colours(
    scene: Scene, config: EnvConfig
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices of the colours each target may be drawn in, (K, C), and how many they are, (K,)."""
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
    """Draw a fixed list of episodes that shares none with training streams.

    Args:
        scene: the robot and targets.
        config: whether colours are randomized.
        count: number of episodes.
        seed: seed of the list; a longer list begins with the shorter one.
    """
    streams = np.full(count, derive(seed, "evaluation"), dtype=np.uint64)
    return draw_episodes(scene, config, streams, np.arange(count, dtype=np.uint64))
