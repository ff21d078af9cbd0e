"""Training of perception modules on images of the simulator, and the classifier's accuracy."""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor, nn

from knowarm.cores import torch_threads
from knowarm.errors import UserError
from knowarm.learn.optimizer import resolve_precision
from knowarm.perception.classifier import FacetClassifier, accuracy
from knowarm.perception.config import GroundingConfig, ModuleSpec, PerceptionConfig
from knowarm.perception.grounding import GroundingNetwork
from knowarm.perception.images import ImageSampler, query_answers, sample_images
from knowarm.seeding import derive_seed, torch_generator
from knowarm.world.config import EnvConfig
from knowarm.world.scene.appearance import VisualRandomization
from knowarm.world.tasks.held_out import HeldOut

LOOKS = VisualRandomization(
    light=0.3, light_angle_deg=20.0, camera_shift_m=0.02, camera_turn_deg=2.0, surface_colour=0.2
)
"""Visual randomization of the test."""

QUERIES = 48
"""Queries per gradient step."""

CLASSIFIER_IMAGES, TESTS, GROUNDING_IMAGES = range(3)
"""Numbers of the random streams of images."""

Step = tuple[int, Tensor, Tensor]
"""Number of images of a gradient step, the loss that is minimized, and the one that is reported."""


def train_classifier(
    env: EnvConfig,
    config: PerceptionConfig,
    *,
    report: Callable[[str], None] = lambda text: None,
) -> FacetClassifier:
    """Train a facet classifier for a task on the simulator's labels, and measure its accuracy.

    Args:
        env: the task; colours that it holds out of training are held out here, too.
        config: images, epochs and seed.
        report: receives a line after every epoch.

    Raises:
        UserError: the colours to hold out do not exist, or the task has queries.
    """
    env = without_colours(env, config.held_out_colours)
    held_out = env.held_out.colours if env.held_out else ()
    spec = ModuleSpec.of(env, replace(config, held_out_colours=held_out))
    classifier = FacetClassifier(spec, seed=config.seed)
    seed = derive_seed(config.seed, "perception", CLASSIFIER_IMAGES)
    labels = sample_images(env, spec, config.images, seed)
    generator = torch_generator(config.seed, "perception", CLASSIFIER_IMAGES)

    def epoch(number: int) -> Iterator[Step]:
        for rows in torch.randperm(config.images, generator=generator).split(config.batch):
            loss = classifier.loss(labels, rows)
            yield len(rows), loss, loss

    _fit(classifier, config, epoch, config.epochs, "epoch", report)
    tests = {"new images": env}
    if env.held_out is not None and held_out:
        tests["held-out colours"] = replace(env, held_out=replace(env.held_out, play="held_out"))
    tests["visual randomization"] = replace(env, randomization=LOOKS)
    measured = {}
    for number, (name, tested) in enumerate(tests.items()):
        seed = derive_seed(config.seed, "perception", TESTS, number)
        labels = sample_images(tested, spec, config.test_images, seed)
        measured[name] = accuracy(classifier, labels, tested)
    classifier.spec = replace(spec, accuracy=measured)
    return classifier


def without_colours(env: EnvConfig, colours: tuple[str, ...]) -> EnvConfig:
    """Return a task that does not show some colours; its queries must not decide what it shows."""
    if not colours:
        return env
    if not env.task.holds_out:
        raise UserError(
            f"held_out_colours cannot be combined with the task {env.task.kind!r}, whose questions "
            "decide what is visible. Leave held_out_colours out."
        )
    places = None if env.held_out is None else env.held_out.places
    return replace(env, held_out=HeldOut(colours=colours, places=places))


def train_grounding(
    env: EnvConfig,
    knowledge: np.ndarray,
    slots: int,
    config: GroundingConfig,
    *,
    seed: int,
    report: Callable[[str], None] = lambda text: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> GroundingNetwork | None:
    """Train a network to find what queries mean.

    Convolutions are computed in bfloat16 where the processor has it.

    Args:
        env: a task with queries.
        knowledge: (Q, K) float32, one row of ``slots`` equal parts per query.
        slots: number of parts.
        config: images, rounds and losses (`GroundingNetwork.losses`).
        seed: of the run.
        report: receives a line at the start and after every round.
        should_stop: called before every round; the result is then None.
    """
    report(f"training the grounding network on {config.rounds} x {config.images:,} images")
    network = GroundingNetwork(ModuleSpec.of(env, config), knowledge, slots, seed=seed)
    sampler = ImageSampler(env, network.spec, derive_seed(seed, "perception", GROUNDING_IMAGES))
    answers = query_answers(env, network.spec.facets)
    assert answers is not None
    bfloat16 = resolve_precision("auto", torch.device("cpu")) == "bfloat16"
    generator = torch_generator(seed, "perception", GROUNDING_IMAGES)

    def training_round(number: int) -> Iterator[Step]:
        labels = sampler.sample(config.images)
        if number == 1:
            positions = labels.grasp_position.flatten(0, -2)
            network.position_mean = positions.mean(0)
            network.position_std = positions.std(0).clamp(min=1e-3)
        for rows in torch.arange(config.images).split(config.batch):
            queries = torch.randperm(len(knowledge), generator=generator)[:QUERIES]
            place, naming, frame = network.losses(
                labels, rows, queries, answers, naming=config.naming, bfloat16=bfloat16
            )
            loss = place + config.naming_coef * naming + config.frame_coef * frame
            yield len(rows), loss, place

    with torch_threads(1), closing(sampler):
        name = "grounding, round"
        done = _fit(network, config, training_round, config.rounds, name, report, should_stop)
    return network if done else None


def _fit(
    module: nn.Module,
    config: PerceptionConfig | GroundingConfig,
    steps: Callable[[int], Iterator[Step]],
    passes: int,
    name: str,
    report: Callable[[str], None],
    should_stop: Callable[[], bool] = lambda: False,
) -> bool:
    """Minimize the losses of each pass's steps with Adam; return whether it was not stopped."""
    count = -(-config.images // config.batch) * passes
    optimizer = torch.optim.Adam(module.parameters(), config.learning_rate)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, config.learning_rate, total_steps=max(2, count)
    )
    for number in range(1, passes + 1):
        if should_stop():
            return False
        total = 0.0
        for images, loss, reported in steps(number):
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
            total += float(reported.detach()) * images
        report(f"{name} {number} of {passes}: loss {total / config.images:.3f}")
    module.eval().requires_grad_(False)
    return True
