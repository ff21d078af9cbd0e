"""First images of episodes, with what the simulator knows about them: labels for training."""

from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

from knowarm.experiment.perception import Seen
from knowarm.world.config import EnvConfig
from knowarm.world.scene import Scene, project, target_places
from knowarm.world.vector_env import ReachVectorEnv

ENVS = 256
"""Images drawn at once."""

HEIGHT_M = 0.05
"""Height above the support of the point that stands for an object in the image [m]."""


@dataclass(frozen=True)
class Starts:
    """First images of N episodes that show m objects, the wanted one first."""

    images: Tensor
    """(N, H, W, 3) uint8."""
    facets: Tensor
    """(N, m) int64, facets of a module."""
    queries: Tensor
    """(N,) int64, rows of the knowledge table; 0 where nothing is asked."""
    pixels: Tensor
    """(N, m, 2) float32: column and row of the objects [px]."""
    grasp_position: Tensor
    """(N, m, 3) float32 [m], world."""
    grasp_axes: Tensor
    """(N, m, 6) float32: x and z axis of the grasp frames, world."""


class FirstImages:
    """Draws the first images of episodes, each of them once.

    Args:
        env: the task.
        seen: the facets, in their order.
        seed: of the episodes.
        at_once: number of environments; another one draws other episodes.
    """

    def __init__(self, env: EnvConfig, seen: Seen, seed: int, at_once: int = ENVS) -> None:
        self._world = ReachVectorEnv(env, at_once)
        self._numbers = facet_numbers(self._world.scene, seen)
        self._seed: int | None = seed

    def draw(self, count: int) -> Starts:
        """Draw the next N first images, and those up to a multiple of ``at_once`` in vain."""
        parts = [self._draw() for _ in range(0, count, self._world.num_envs)]
        names = [field.name for field in fields(Starts)]
        return Starts(
            **{name: torch.cat([getattr(part, name) for part in parts])[:count] for name in names}
        )

    def close(self) -> None:
        """Close the environments."""
        self._world.close()

    def _draw(self) -> Starts:
        scene, task = self._world.scene, self._world.task
        images, infos = self._world.reset(seed=self._seed)
        self._seed = None
        objects = infos.get("objects", infos["target"][:, None])
        colours = infos.get("object_colours", infos["colour"][:, None])
        ground = target_places(scene, infos.get("object_positions", task.position[:, None]))
        # Right and up from the centre, in half image widths.
        point = project(scene, (ground + np.array([0, 0, HEIGHT_M])).reshape(-1, 3))
        pixels = (1 + point * [1, -1]) / 2 * images.shape[1]
        axes = scene.grasp_matrix.reshape(-1, 3, 3)[objects][..., [0, 2]].swapaxes(-1, -2)
        return Starts(
            torch.from_numpy(images),
            torch.from_numpy(self._numbers[objects, colours]),
            torch.from_numpy(infos.get("query", np.zeros(len(images))).astype(np.int64)),
            _float(pixels.reshape(*objects.shape, 2)),
            _float(ground + scene.grasp_position[objects]),
            _float(axes.reshape(*objects.shape, 6)),
        )


def draw_first_images(env: EnvConfig, seen: Seen, count: int, seed: int) -> Starts:
    """Draw the first images of N episodes; arguments as `FirstImages`."""
    source = FirstImages(env, seen, seed, min(ENVS, count))
    try:
        return source.draw(count)
    finally:
        source.close()


def facet_numbers(scene: Scene, seen: Seen) -> np.ndarray:
    """Return the facet of each target in each of its colours, (targets, colours) int64."""
    most = max(map(len, scene.colour_names))
    table = np.zeros((len(scene.targets), most), np.int64)
    for number, (target, names) in enumerate(zip(scene.targets, scene.colour_names, strict=True)):
        for colour, name in enumerate(names):
            if (target.name, name) in seen.facets:
                table[number, colour] = seen.facets.index((target.name, name))
    return table


def _float(values: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, np.float32))
