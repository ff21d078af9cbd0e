"""Training of a perception module on images of the simulator, and its accuracy."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import torch

from knowarm.errors import UserError
from knowarm.experiment.first_images import Starts, draw_first_images
from knowarm.experiment.perception import Perception, PerceptionConfig, Seen
from knowarm.seeding import derive_seed, torch_generator
from knowarm.world.choice_source import choice_table
from knowarm.world.config import EnvConfig
from knowarm.world.held_out import HeldOut
from knowarm.world.visual_randomization import VisualRandomization

TEST_BATCH = 256
"""Images that are named at once."""

LOOKS = VisualRandomization(
    light=0.3, light_angle_deg=20.0, camera_shift_m=0.02, camera_turn_deg=2.0, surface_colour=0.2
)
"""Visual randomization of the test."""

HELD_OUT, COLOURS, RANDOMIZED = "new images", "held-out colours", "visual randomization"
"""Tests, as they are named in the file."""

IMAGES, TESTS = 0, 1
"""Numbers of the streams of training images and of those of the tests."""


def train_perception(
    env: EnvConfig,
    config: PerceptionConfig,
    *,
    report: Callable[[int, float], None] = lambda epoch, loss: None,
) -> Perception:
    """Train a perception module for a task, and measure its accuracy.

    The labels are used here only; a trained module gets nothing but the image.

    Args:
        env: the task; colours that it holds out of training are held out here, too.
        config: images, epochs and seed.
        report: called after every epoch with its number and mean loss.

    Raises:
        UserError: colours that the objects do not have are held out, or a task that asks holds
            colours out.
    """
    env = training_env(env, config)
    held_out = () if env.held_out is None else env.held_out.colours
    seen = Seen.of(env, replace(config, held_out_colours=held_out))
    perception = Perception(seen, seed=config.seed)
    seed = derive_seed(config.seed, "perception", IMAGES)
    _fit(perception, draw_first_images(env, seen, config.images, seed), config, report)
    perception.eval().requires_grad_(False)
    perception.seen = replace(seen, accuracy=measure(perception, env))
    return perception


def training_env(env: EnvConfig, config: PerceptionConfig) -> EnvConfig:
    """Return the task whose images are trained on: without the held-out colours."""
    if not config.held_out_colours:
        return env
    if env.choice is not None:
        raise UserError(
            "held_out_colours hides colours of reaching; what the choice task shows is decided by "
            "its queries. Leave held_out_colours out."
        )
    places = None if env.held_out is None else env.held_out.places
    return replace(env, held_out=HeldOut(colours=config.held_out_colours, places=places))


def _fit(
    perception: Perception,
    starts: Starts,
    config: PerceptionConfig,
    report: Callable[[int, float], None],
) -> None:
    """Maximize the likelihood of the visible facets, with equal shares of a softmax."""
    count = len(starts.images)
    batches = -(-count // config.batch)
    optimizer = torch.optim.Adam(perception.parameters(), config.learning_rate)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, config.learning_rate, total_steps=max(2, batches * config.epochs)
    )
    generator = torch_generator(config.seed, "perception", IMAGES)
    for epoch in range(1, config.epochs + 1):
        total = 0.0
        for ids in torch.randperm(count, generator=generator).split(config.batch):
            likelihood = perception(starts.images[ids]).log_softmax(dim=1)
            loss = -likelihood.gather(1, starts.facets[ids]).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
            total += float(loss.detach()) * len(ids)
        report(epoch, total / count)


def measure(perception: Perception, env: EnvConfig) -> dict[str, dict[str, float]]:
    """Measure what a module names rightly, on images that it was not trained on.

    Args:
        perception: the module.
        env: the task that it was trained on.

    Returns:
        By test, shares of the visible objects: "objects" named, "colours" named of these objects,
        and "both". Where the task asks also "told": the share of queries for which the surest
        facet among those that answer is the wanted one.
    """
    config = perception.seen.config
    found = {}
    for number, (name, tested) in enumerate(_tests(env)):
        seed = derive_seed(config.seed, "perception", TESTS, number)
        starts = draw_first_images(tested, perception.seen, config.test_images, seed)
        found[name] = shares(perception, starts, tested)
    return found


def _tests(env: EnvConfig) -> Iterator[tuple[str, EnvConfig]]:
    """Return the tests and their tasks."""
    yield HELD_OUT, env
    if env.held_out is not None and env.held_out.colours:
        yield COLOURS, replace(env, held_out=replace(env.held_out, play="held_out"))
    yield RANDOMIZED, replace(env, randomization=LOOKS)


@torch.inference_mode()
def shares(perception: Perception, starts: Starts, env: EnvConfig) -> dict[str, float]:
    """Return the shares that were named rightly, as in `measure`.

    Args:
        perception: the module.
        starts: images to name.
        env: the task of the images.
    """
    scores = torch.cat([perception(part) for part in starts.images.split(TEST_BATCH)])
    facets = perception.seen.facets
    count = starts.facets.shape[1]
    named = scores.topk(count, dim=1).indices
    objects = list(dict.fromkeys(name for name, _ in facets))
    owner = torch.tensor([objects.index(name) for name, _ in facets])
    colours = list(dict.fromkeys(colour for _, colour in facets))
    colour = torch.tensor([colours.index(name) for _, name in facets])
    # Each visible object is compared with every named facet: (N, m, m).
    same = owner[starts.facets][:, :, None] == owner[named][:, None]
    alike = colour[starts.facets][:, :, None] == colour[named][:, None]
    found, both = same.any(2), (same & alike).any(2)
    found_shares = {
        "objects": float(found.float().mean()),
        "colours": float(both.sum() / found.sum().clamp(min=1)),
        "both": float(both.float().mean()),
    }
    if env.choice is not None:
        answers = torch.from_numpy(answers_of(env, facets))[starts.queries]
        told = scores.masked_fill(~answers, -torch.inf).argmax(1)
        found_shares["told"] = float((told == starts.facets[:, 0]).float().mean())
    return found_shares


def answers_of(env: EnvConfig, facets: tuple[tuple[str, str], ...]) -> np.ndarray:
    """Return which facets answer each query of a task that asks, (Q, F) bool."""
    table = choice_table(env)
    columns = [table.facets.index(facet) if facet in table.facets else -1 for facet in facets]
    answers = np.concatenate([table.satisfies, np.zeros((len(table.queries), 1), np.bool_)], axis=1)
    return np.ascontiguousarray(answers[:, columns])
