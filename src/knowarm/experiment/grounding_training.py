"""Training of a grounding network on images of the simulator."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from knowarm.experiment.grounding import Grounding, GroundingConfig, place_of
from knowarm.experiment.perception import PerceptionConfig, Seen
from knowarm.experiment.perception_training import facet_numbers
from knowarm.learn.device import resolve_precision
from knowarm.seeding import derive_seed, torch_generator
from knowarm.world.choice_source import choice_table
from knowarm.world.config import EnvConfig
from knowarm.world.scene import project
from knowarm.world.vector_env import ReachVectorEnv

ENVS = 512
"""Images drawn at once."""

HEIGHT_M = 0.05
"""Height above the support of the point that stands for an object [m]."""

QUERIES = 128
"""Queries asked of the images of a gradient step."""

IMAGES = 2
"""Number of the stream of training images."""


@dataclass(frozen=True)
class Starts:
    """First images of N episodes that show m objects, the wanted one first."""

    images: Tensor
    """(N, H, W, 3) uint8."""
    facets: Tensor
    """(N, m) int64, facets of the network."""
    queries: Tensor
    """(N,) int64."""
    pixels: Tensor
    """(N, m, 2) float32: column and row of the objects [px]."""


def draw_starts(env: EnvConfig, seen: Seen, count: int, seed: int) -> Starts:
    """Draw the first images of episodes of a task that asks.

    Args:
        env: the task.
        seen: the facets, in their order.
        count: N.
        seed: of the episodes.
    """
    world = ReachVectorEnv(env, min(ENVS, count))
    numbers = facet_numbers(world.scene, seen)
    height = world.scene.robot.support_height_m + HEIGHT_M
    parts: list[tuple[np.ndarray, ...]] = []
    start: int | None = seed
    try:
        for _ in range(0, count, world.num_envs):
            images, infos = world.reset(seed=start)
            start, place = None, infos["object_positions"]
            points = np.concatenate([place, np.full_like(place[..., :1], height)], axis=-1)
            # Right and up from the centre, in half image widths.
            point = project(world.scene, points.reshape(-1, 3)).reshape(place.shape)
            pixels = (1 + point * [1, -1]) / 2 * env.image_size
            facets = numbers[infos["objects"], infos["object_colours"]]
            parts.append((images, facets, infos["query"].astype(np.int64), pixels))
    finally:
        world.close()
    image, facet, query, pixel = (
        torch.from_numpy(np.concatenate(part)[:count]) for part in zip(*parts, strict=True)
    )
    return Starts(image, facet, query, pixel.float())


def train_grounding(
    env: EnvConfig,
    knowledge: np.ndarray,
    slots: int,
    config: GroundingConfig,
    *,
    seed: int,
    report: Callable[[str], None] = lambda text: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> Grounding | None:
    """Train a network to find what queries mean.

    Every image answers many queries: all questions of the task that single out one of its objects.
    The loss is the cross-entropy of that object's place over `QUERIES` of them, plus that of the
    names. The labels are used here only; a trained network gets image and query. Convolutions are
    computed in bfloat16 where the processor has it.

    Args:
        env: the task that asks; the questions that its queries may ask are trained on.
        knowledge: (Q, K) float32, what each query is described by.
        slots: equal parts of a row.
        config: images, epochs and losses.
        seed: of the run; images, order and weights have streams of their own.
        report: receives a line at the start and after every epoch.
        should_stop: asked before every epoch.

    Returns:
        The network; None if it was stopped.
    """
    report(f"training the grounding network on {config.images:,} images")
    trained = PerceptionConfig(
        images=config.images,
        epochs=config.epochs,
        batch=config.batch,
        learning_rate=config.learning_rate,
        seed=seed,
    )
    network = Grounding(Seen.of(env, trained), knowledge, slots, seed=seed)
    starts = draw_starts(env, network.seen, config.images, derive_seed(seed, "perception", IMAGES))
    task = _Task(env, network, starts)
    batches = -(-config.images // config.batch)
    optimizer = torch.optim.Adam(network.parameters(), config.learning_rate)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, config.learning_rate, total_steps=max(2, batches * config.epochs)
    )
    generator = torch_generator(seed, "perception", IMAGES)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # the same sums on every machine
    try:
        for epoch in range(1, config.epochs + 1):
            if should_stop():
                return None
            total = 0.0
            for rows in torch.randperm(config.images, generator=generator).split(config.batch):
                queries = torch.randperm(len(knowledge), generator=generator)[:QUERIES]
                place, naming = task.losses(rows, queries)
                optimizer.zero_grad()
                (place + config.naming_coef * naming).backward()
                optimizer.step()
                schedule.step()
                total += float(place.detach()) * len(rows)
            report(f"grounding, epoch {epoch} of {config.epochs}: loss {total / config.images:.3f}")
    finally:
        torch.set_num_threads(threads)
    network.eval().requires_grad_(False)
    return network


class _Task:
    """Questions that the images of a training answer.

    Args:
        env: the task.
        network: trained.
        starts: the images.
    """

    def __init__(self, env: EnvConfig, network: Grounding, starts: Starts) -> None:
        self._network, self._starts = network, starts
        self._low = resolve_precision("auto", torch.device("cpu")) == "bfloat16"
        self._place = place_of(starts.pixels, env.image_size)
        table, facets = choice_table(env), network.seen.facets
        columns = [facets.index(facet) for facet in table.facets]
        self._satisfies, self._askable = (
            torch.zeros(len(table.queries), len(facets), dtype=torch.bool) for _ in range(2)
        )
        self._satisfies[:, columns] = torch.from_numpy(table.satisfies)
        self._askable[:, columns] = torch.from_numpy(table.askable)

    def losses(self, rows: Tensor, queries: Tensor) -> tuple[Tensor, Tensor]:
        """Return the losses of places, for some queries, and of names on some images."""
        network, starts = self._network, self._starts
        with torch.autocast("cpu", torch.bfloat16, enabled=self._low):
            features = network.features(starts.images[rows])
        features = features.float()
        wanted = network.wanted(network.knowledge[queries])
        scores = network.keys(features) @ wanted.T  # (n, P, q)
        facets = starts.facets[rows]
        answers = self._satisfies[queries][:, facets].transpose(0, 1)  # (n, q, m)
        askable = self._askable[queries][:, facets].transpose(0, 1)
        asked = (answers.sum(2) == 1) & (answers & askable).any(2)
        place = self._place[rows].gather(1, answers.float().argmax(2))
        likelihood = scores.log_softmax(1).gather(1, place[:, None])[:, 0]
        named = network.names(features).log_softmax(1).gather(1, facets)
        return -(likelihood * asked).sum() / asked.sum().clamp(min=1), -named.mean()
