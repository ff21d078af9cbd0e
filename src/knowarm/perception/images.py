"""First images of episodes, labelled by the simulator, and the answers to a task's queries."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from knowarm.learn.checkpoint import Arrays
from knowarm.perception.config import Facets, GroundingSpec
from knowarm.perception.looks import look_of
from knowarm.questions import ObjectColour
from knowarm.world.config import EnvConfig, questions_of
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.scene.scene import Scene, project, target_places

ENVS = 256
"""Images drawn at once."""
HEIGHT_M = 0.05
"""Height above the support of the point that stands for an object in the image [m]."""


class LabelledImages(NamedTuple):
    """First images of N episodes that show m objects, the target first."""

    images: Tensor  # (N, H, W, 3) uint8
    facets: Tensor  # (N, m) int64, facets of the network
    # (N,) int64, rows of the knowledge table; 0 for a task without queries
    queries: Tensor
    pixels: Tensor  # (N, m, 2) float32: column and row of the objects [px]
    grasp_position: Tensor  # (N, m, 3) float32 [m], world
    grasp_axes: Tensor  # (N, m, 6) float32: x and z axis of the grasp frames, world

    def of(self, rows: Tensor) -> "LabelledImages":
        """Return some of the images (n,) int64 with their labels."""
        return LabelledImages(*(tensor[rows] for tensor in self))


class QueryAnswers(NamedTuple):
    """Facets (Q, F) bool that answer Q queries, and for which the task may ask them."""

    satisfies: Tensor
    askable: Tensor
    marked: bool  # Whether the image marks the target

    def of(self, queries: Tensor) -> "QueryAnswers":
        """Return the answers to some queries (q,) int64."""
        return self._replace(
            satisfies=self.satisfies[queries], askable=self.askable[queries]
        )


def query_answers(env: EnvConfig, facets: Facets) -> QueryAnswers | None:
    """Return the answers to a task's queries among some facets; None without queries."""
    table = questions_of(env)
    if table is None:
        return None
    satisfies = _columns_of(table.satisfies, table.facets, facets)
    askable = _columns_of(table.askable, table.facets, facets)
    return QueryAnswers(satisfies, askable, env.task.asked.paints_goal)


def _columns_of(
    table: np.ndarray, names: Sequence[ObjectColour], facets: Sequence[ObjectColour]
) -> Tensor:
    """Return the columns of some facets from a table (Q, F) bool with names; False without one."""
    columns = {name: column for column, name in enumerate(names)}
    chosen = [columns.get(facet, -1) for facet in facets]
    padded = np.pad(table, ((0, 0), (0, 1)))
    return torch.from_numpy(padded[:, chosen])


class ImageSampler:
    """Samples the first images of episodes; their seed and number at once decide which."""

    def __init__(
        self, env: EnvConfig, spec: GroundingSpec, seed: int, at_once: int = ENVS
    ) -> None:
        self._world = ArmVectorEnv(env, at_once)
        self._first_facets = first_facets(self._world.scene, spec)
        self._seed: int | None = seed

    def sample(self, count: int) -> LabelledImages:
        """Sample N images; of the last ``at_once``, the rest is discarded."""
        batches = [self._sample() for _ in range(0, count, self._world.num_envs)]
        fields = zip(*batches, strict=True)
        return LabelledImages(*(torch.cat(tensors)[:count] for tensors in fields))

    def get_state(self) -> Arrays:
        """Copy all that determines the following images."""
        return self._world.get_state()

    def set_state(self, state: Arrays) -> None:
        """Restore a state of `get_state`."""
        self._seed = None
        self._world.set_state(state)

    def _sample(self) -> LabelledImages:
        scene = self._world.scene
        images, _ = self._world.reset(seed=self._seed)
        self._seed = None
        episodes = self._world.running
        objects = episodes.objects
        ground = target_places(scene, episodes.positions)
        return LabelledImages(
            images=torch.from_numpy(images),
            facets=torch.from_numpy(self._first_facets[objects] + episodes.colours),
            queries=torch.from_numpy(episodes.question),
            pixels=pixels_of(scene, episodes.positions, images.shape[1]),
            grasp_position=_float(ground + scene.grasp_position[objects]),
            grasp_axes=_float(axes_of(scene.grasp_matrix[objects])),
        )


def axes_of(matrices: np.ndarray) -> np.ndarray:
    """Return x and z axis of the grasp frames of rotation matrices (..., 3, 3), (..., 6)."""
    axes = matrices[..., [0, 2]].swapaxes(-1, -2)
    return axes.reshape(*matrices.shape[:-2], 6)


def pixels_of(scene: Scene, positions: np.ndarray, image_size: int) -> Tensor:
    """Return where objects at x and y (..., 2) [m] stand in the image, (..., 2) float32 [px]."""
    raised = target_places(scene, positions) + np.array([0, 0, HEIGHT_M])
    # Right and up from the centre, in half widths
    point = project(scene, raised.reshape(-1, 3))
    pixels = (1 + point * [1, -1]) / 2 * image_size
    return _float(pixels.reshape(positions.shape))


def sample_images(
    env: EnvConfig, spec: GroundingSpec, count: int, seed: int
) -> LabelledImages:
    """Sample the first images of N episodes; arguments as `ImageSampler`."""
    return ImageSampler(env, spec, seed, min(ENVS, count)).sample(count)


def first_facets(scene: Scene, spec: GroundingSpec) -> np.ndarray:
    """Return the facet of each target in its first colour, (targets,) int64; others follow.

    An object that a template makes has the facet of the one that looks like it.
    """
    first: dict[tuple[str, ...], int] = {}
    for number, (name, _) in enumerate(spec.facets):
        first.setdefault(look_of(name), number)
    return np.array([first[look_of(target.name)] for target in scene.targets])


def _float(values: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, np.float32))
