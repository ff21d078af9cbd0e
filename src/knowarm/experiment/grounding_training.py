"""Training of a grounding network on images of the simulator."""

from collections.abc import Callable
from contextlib import closing

import numpy as np
import torch
from torch import Tensor

from knowarm.experiment.first_images import FirstImages, Starts
from knowarm.experiment.grounding import Grounding, GroundingConfig, place_of
from knowarm.experiment.perception import PerceptionConfig, Seen
from knowarm.learn.device import resolve_precision
from knowarm.seeding import derive_seed, torch_generator
from knowarm.threads import torch_threads
from knowarm.world.choice_source import choice_table
from knowarm.world.config import EnvConfig

QUERIES = 48
"""Queries asked of the images of a gradient step."""

IMAGES = 2
"""Number of the stream of training images."""


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
    names, plus the squared error of the grasp frames. The labels are used here only; a trained
    network gets image and query. Convolutions are computed in bfloat16 where the processor has it.

    Args:
        env: the task that asks; the questions that its queries may ask are trained on.
        knowledge: (Q, K) float32, what each query is described by.
        slots: equal parts of a row.
        config: images, rounds and losses.
        seed: of the run; images, order and weights have streams of their own.
        report: receives a line at the start and after every round.
        should_stop: asked before every round.

    Returns:
        The network; None if it was stopped.
    """
    report(f"training the grounding network on {config.rounds} x {config.images:,} images")
    trained = PerceptionConfig(
        images=config.images,
        epochs=config.rounds,
        batch=config.batch,
        learning_rate=config.learning_rate,
        seed=seed,
    )
    network = Grounding(Seen.of(env, trained), knowledge, slots, seed=seed)
    first_images = FirstImages(env, network.seen, derive_seed(seed, "perception", IMAGES))
    task = _Task(env, network)
    steps = -(-config.images // config.batch) * config.rounds
    optimizer = torch.optim.Adam(network.parameters(), config.learning_rate)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, config.learning_rate, total_steps=max(2, steps)
    )
    generator = torch_generator(seed, "perception", IMAGES)
    with torch_threads(1), closing(first_images):
        for number in range(1, config.rounds + 1):
            if should_stop():
                return None
            starts, total = first_images.draw(config.images), 0.0
            if number == 1:
                network.standardize(starts.grasp_position)
            for rows in torch.arange(config.images).split(config.batch):
                queries = torch.randperm(len(knowledge), generator=generator)[:QUERIES]
                place, naming, frame = task.losses(starts, rows, queries)
                optimizer.zero_grad()
                (place + config.naming_coef * naming + config.frame_coef * frame).backward()
                optimizer.step()
                schedule.step()
                total += float(place.detach()) * len(rows)
            report(
                f"grounding, round {number} of {config.rounds}: loss {total / config.images:.3f}"
            )
    network.eval().requires_grad_(False)
    return network


class _Task:
    """Questions that the images of a training answer.

    Args:
        env: the task.
        network: trained.
    """

    def __init__(self, env: EnvConfig, network: Grounding) -> None:
        assert env.choice is not None
        self._network, self._size = network, env.image_size
        self._marked = env.choice.marked
        self._low = resolve_precision("auto", torch.device("cpu")) == "bfloat16"
        table, facets = choice_table(env), network.seen.facets
        columns = [facets.index(facet) for facet in table.facets]
        self._satisfies, self._askable = (
            torch.zeros(len(table.queries), len(facets), dtype=torch.bool) for _ in range(2)
        )
        self._satisfies[:, columns] = torch.from_numpy(table.satisfies)
        self._askable[:, columns] = torch.from_numpy(table.askable)

    def losses(
        self, starts: Starts, rows: Tensor, queries: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the losses of places, for some queries, names and grasp frames on some images."""
        network, places = self._network, place_of(starts.pixels[rows], self._size)
        with torch.autocast("cpu", torch.bfloat16, enabled=self._low):
            features = network.features(starts.images[rows])
            keys = network.keys(features)
        features = features.float()
        wanted = network.wanted(network.knowledge[queries])
        scores = keys.float() @ wanted.T  # (n, P, q)
        facets = starts.facets[rows]
        answers = self._satisfies[queries][:, facets].transpose(0, 1)  # (n, q, m)
        askable = self._askable[queries][:, facets].transpose(0, 1)
        asked = (answers.sum(2) == 1) & (answers & askable).any(2)
        if self._marked:  # the image answers for the marked object only
            asked &= answers[..., 0]
        place = places.gather(1, answers.float().argmax(2))
        likelihood = scores.log_softmax(1).gather(1, place[:, None])[:, 0]
        named = network.names(features).log_softmax(1).gather(1, facets)
        position = network.standardized(starts.grasp_position[rows])
        truth = torch.cat((position, starts.grasp_axes[rows]), 2)
        error = (network.frames(features, places) - truth).square().mean()
        return -(likelihood * asked).sum() / asked.sum().clamp(min=1), -named.mean(), error
