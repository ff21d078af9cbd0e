"""Seeds go in; ``Episodes``, the start of each episode as plain arrays, come out."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from knowarm.world.config import EnvConfig
from knowarm.world.draws import derive, uniforms
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
    u = uniforms(streams, indices, _JOINTS + scene.num_joints)
    target = (u[:, _TARGET] * len(scene.targets)).astype(np.int64)
    centre, half = np.array(robot.rectangle_centre_m), np.array(robot.rectangle_half_size_m)
    position = centre + (2 * u[:, _X : _Y + 1] - 1) * half
    if config.colours == "randomized":
        colour = (u[:, _COLOUR] * scene.colour_count[target]).astype(np.int64)
    else:
        colour = np.zeros(len(target), dtype=np.int64)
    start = list(robot.start_joints)
    reach = robot.start_fraction * (scene.joint_upper - scene.joint_lower)[start] / 2
    offsets = np.zeros((len(target), scene.num_joints))
    offsets[:, start] = (2 * u[:, _JOINTS:][:, start] - 1) * reach
    return Episodes(offsets, target, position, colour)


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
