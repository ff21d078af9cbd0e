"""Seeds go in; ``Episodes``, the start of each episode as plain arrays, come out."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from knowarm.world.config import EnvConfig
from knowarm.world.draws import derive, uniforms
from knowarm.world.held_out import TRIES, allowed_colours, check_names, choose_places
from knowarm.world.scene import Scene

_TARGET, _X, _Y, _COLOUR, _JOINTS = range(5)  # order of an episode's draws


@dataclass(frozen=True)
class Episodes:
    """Where n episodes start. Drawn first and played later, so a fixed set is just this."""

    joint_offsets: NDArray[np.float64]
    """Start angle of each joint relative to home [rad], (n, J)."""

    target: NDArray[np.int64]
    """Index into the config's targets, (n,)."""

    position: NDArray[np.float64]
    """Where the target stands, x and y [m], (n, 2)."""

    colour: NDArray[np.int64]
    """Index into the target's colours, (n,)."""

    look: NDArray[np.float64]
    """Uniform draws of what varies in the picture, (n, L); L = 0 when nothing does."""

    def __len__(self) -> int:
        return len(self.target)

    def __getitem__(self, index: slice | NDArray[np.intp] | NDArray[np.bool_]) -> "Episodes":
        """Pick episodes by a slice or an index array."""
        return Episodes(*(getattr(self, field.name)[index] for field in fields(self)))


def draw_episodes(
    scene: Scene, config: EnvConfig, streams: NDArray[np.uint64], indices: NDArray[np.uint64]
) -> Episodes:
    """Draw episodes by number (paper, table 1).

    Target, place in the rectangle and colour are uniform; the start joints begin within
    +-start_fraction of half their range about home.

    Args:
        scene: the robot and targets.
        config: whether colours are randomized.
        streams: seed of each episode's stream, (n,) uint64.
        indices: number of the episode in its stream, (n,) uint64.

    Returns:
        n episodes; the same numbers give the same episode at any n.
    """
    robot = scene.robot
    looks = _JOINTS + scene.num_joints
    places = looks + config.randomization.draws
    count = places + (2 * TRIES if config.held_out and config.held_out.places else 0)
    u = uniforms(streams, indices, count)
    target = (u[:, _TARGET] * len(scene.targets)).astype(np.int64)
    centre, half = np.array(robot.rectangle_centre_m), np.array(robot.rectangle_half_size_m)
    candidates = np.concatenate([u[:, _X : _Y + 1], u[:, places:]], axis=1).reshape(len(u), -1, 2)
    position = centre + choose_places(config.held_out, 2 * candidates - 1) * half
    colour = _colours(scene, config, target, u[:, _COLOUR])
    start = list(robot.start_joints)
    reach = robot.start_fraction * (scene.joint_upper - scene.joint_lower)[start] / 2
    offsets = np.zeros((len(target), scene.num_joints))
    offsets[:, start] = (2 * u[:, _JOINTS:][:, start] - 1) * reach
    return Episodes(offsets, target, position, colour, u[:, looks:places])


def _colours(
    scene: Scene,
    config: EnvConfig,
    target: NDArray[np.int64],
    draws: NDArray[np.float64],
) -> NDArray[np.int64]:
    """Index of each episode's colour among its target's, of those that may be drawn, (n,)."""
    every = [names if config.colours == "randomized" else names[:1] for names in scene.colour_names]
    check_names(config.held_out, [name for names in every for name in names])
    allowed = [
        allowed_colours(config.held_out, names, one.name)
        for names, one in zip(every, scene.targets, strict=True)
    ]
    table = np.zeros((len(allowed), max(map(len, allowed))), dtype=np.int64)
    for k, indices in enumerate(allowed):
        table[k, : len(indices)] = indices
    count = np.array([len(indices) for indices in allowed])
    return table[target, (draws * count[target]).astype(np.int64)]


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
