"""Training of grounding networks on images of the simulator, with a cache of the results."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
import torch
from torch import Tensor

from knowarm.cores import torch_threads
from knowarm.learn.optimizer import resolve_precision
from knowarm.perception.config import GroundingConfig, GroundingSpec
from knowarm.perception.grounding import (
    GroundingNetwork,
    Standardize,
    in_batches,
    place_of,
)
from knowarm.perception.images import (
    ImageSampler,
    LabelledImages,
    query_answers,
    sample_images,
)
from knowarm.perception.training import PassProgress, Step, minimize
from knowarm.seeding import derive_seed, torch_generator
from knowarm.world.cache import cache_file, read_arrays, write_arrays
from knowarm.world.config import EnvConfig

FRAME_COEF = 10.0
"""Weight of the squared error of the grasp frames of all visible objects."""
REVISION = 2
"""Part of the cache's key; another one wherever the same config trains another network."""

QUERIES = 48
"""Queries per gradient step."""

GROUNDING_IMAGES = 2
"""Number of the random streams of images."""

HEAD = 2
"""Number of the random streams of the training of a frame head."""
HEAD_EPOCHS = 8
"""Its passes over the images. A gradient step takes as many objects as one of the network takes
images."""
HEAD_RATE = 2.0
"""Its factor of the learning rate."""

KEYED_IMAGES = 64
"""First images of the training, whose pixels and labels are part of the cache's key."""

RECOGNIZING = ("encoder.", "frame.", "position_")
"""How the names of parameters begin that recognize names and grasp frames."""
COMPARING = ("key.", "query.")
"""How those begin that compare queries with places."""


class _Stage(NamedTuple):
    """A part of a training."""

    name: str
    rounds: int
    recognizes: bool  # Whether it trains names and grasp frames
    asks: bool  # Whether it trains how queries are compared with places

    @property
    def trained(self) -> tuple[str, ...]:
        """How the names of what it trains begin."""
        if not self.asks:
            return RECOGNIZING
        return RECOGNIZING + COMPARING if self.recognizes else COMPARING


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
    """Train a network to find what queries mean, or read it from the user's cache.

    The cache's key contains the first images with their labels, so a changed object or renderer is
    another key. Convolutions are computed in bfloat16 where the processor has it.

    Args:
        env: a task with queries.
        knowledge: (Q, K) float32, one row of ``slots`` equal parts per query.
        slots: number of parts.
        config: images, rounds and weights of the losses.
        seed: of the run; ``config.seed`` goes first.
        report: receives a line at the start and after every round.
        should_stop: called at every gradient step; if it returns true, the result is None.
    """
    if config.seed is not None:
        seed = config.seed
        config = replace(config, seed=None)
    spec = GroundingSpec.of(env, config)
    network = GroundingNetwork(spec, knowledge, slots, seed=seed, first_stage=True)
    answers = query_answers(env, spec.facets)
    assert answers is not None
    vectors = torch.from_numpy(knowledge)
    bfloat16 = resolve_precision("auto", torch.device("cpu")) == "bfloat16"
    generator = torch_generator(seed, "perception", GROUNDING_IMAGES)

    def losses(
        stage: _Stage, labels: LabelledImages, rows: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Compute for some images the loss that is minimized and the one that is reported."""
        features = network.features(labels.images[rows], bfloat16)
        weighted = []
        if stage.asks:
            queries = torch.randperm(len(vectors), generator=generator)[:QUERIES]
            asked = vectors[queries], answers.of(queries)
            place = network.place_loss(
                features, labels, rows, *asked, bfloat16=bfloat16
            )
            weighted.append((1.0, place))
        if stage.recognizes:
            naming, frame = network.recognition_losses(features.float(), labels, rows)
            weighted += [(config.naming_coef, naming), (FRAME_COEF, frame)]
        total = sum(weight * loss for weight, loss in weighted)
        return cast(Tensor, total), weighted[0][1]

    images_alone = config
    stages = [_Stage("everything", config.rounds, recognizes=True, asks=True)]
    if config.shared_rounds > 0:
        images_alone = replace(
            config, rounds=0
        )  # so that other rounds share the first stage
        stages = [
            _Stage(
                "names and frames", config.shared_rounds, recognizes=True, asks=False
            ),
            _Stage("queries", config.rounds, recognizes=False, asks=True),
        ]
    depends_on: list[object] = [
        REVISION,
        version("torch"),
        bfloat16,
        env,
        images_alone,
        seed,
    ]
    for number, stage in enumerate(stages):
        if stage.rounds == 0:
            continue
        path = (number,) if number > 0 else ()
        stream = derive_seed(seed, "perception", GROUNDING_IMAGES, *path)
        first = sample_images(env, spec, KEYED_IMAGES, stream)
        depends_on += [stage.rounds, *[tensor.numpy() for tensor in first]]
        if stage.asks:
            depends_on += [
                knowledge,
                slots,
                answers.satisfies.numpy(),
                answers.askable.numpy(),
            ]
        file = cache_file("grounding", *depends_on)
        parameters = _parameters(network, stage.trained)
        if _copy(read_arrays(file), parameters):
            report(f"grounding network ({stage.name}): read from {file}")
            continue
        for name, parameter in network.named_parameters():
            parameter.requires_grad_(name.startswith(stage.trained))
        report(
            f"training the grounding network ({stage.name}) on {stage.rounds} x "
            f"{config.images:,} images"
        )
        with torch_threads(1):
            sampler = ImageSampler(env, spec, stream)
            progress = _progress(file, sampler, generator)
            is_finished = minimize(
                network,
                config,
                partial(
                    _steps, network, sampler, stage, config, partial(losses, stage)
                ),
                stage.rounds,
                "grounding, round",
                report,
                should_stop,
                progress,
            )
        if not is_finished:
            return None
        write_arrays(file, {name: value.numpy() for name, value in parameters.items()})
        progress.file.unlink(missing_ok=True)
    return train_frame_head(
        network, env, config, seed=seed, report=report, should_stop=should_stop
    )


def train_frame_head(
    trained: GroundingNetwork,
    env: EnvConfig,
    config: GroundingConfig,
    *,
    seed: int,
    report: Callable[[str], None] = lambda text: None,
    should_stop: Callable[[], bool] = lambda: False,
) -> GroundingNetwork | None:
    """Return a network with a new frame head, trained on the features of a trained network.

    Names, keys and queries stay as they are. Arguments as `train_grounding`.
    """
    trained_state = trained.state_dict()
    network = GroundingNetwork(
        trained.spec, trained.knowledge, trained.slots, seed=seed
    )
    state = network.state_dict()
    for name, value in trained_state.items():
        if not name.startswith("frame."):
            state[name] = value
    network.load_state_dict(state)
    inputs_of_head = _parameters(trained, ("encoder.", "position_"))
    arrays = [value.numpy() for value in inputs_of_head.values()]
    file = cache_file(
        "grounding", REVISION, version("torch"), env, config, seed, *arrays
    )
    head = _parameters(network, ("frame.",))
    if _copy(read_arrays(file), head):
        report(f"grounding network (frame head): read from {file}")
        return network.eval().requires_grad_(False)
    network.requires_grad_(False).frame.requires_grad_(True)
    report(f"training the grounding network (frame head) on {config.images:,} images")
    stream = derive_seed(seed, "perception", GROUNDING_IMAGES, HEAD)
    generator = torch_generator(seed, "perception", GROUNDING_IMAGES, HEAD)
    with torch_threads(1):
        labels = sample_images(env, network.spec, config.images, stream)
        places = place_of(labels.pixels, network.spec.image_size)

        def inputs(images: Tensor, places: Tensor) -> Tensor:
            return network.frame_inputs(network.encoder.features(images), places)

        flat = in_batches(inputs, labels.images, places).flatten(0, 1)
        part = network.part_of[labels.facets].flatten()
        frames = network.standardized(labels.grasp_position, labels.grasp_axes).flatten(
            0, 1
        )
        cast(Standardize, network.frame[0]).fit(flat)

        def steps(number: int) -> Iterator[Step]:
            for rows in torch.randperm(len(flat), generator=generator).split(
                config.batch
            ):
                predicted = network.frames_of(flat[rows], part[rows])
                loss = (predicted - frames[rows]).square().mean()
                yield len(rows), loss, loss

        rate = HEAD_RATE * config.learning_rate
        objects = replace(config, images=len(flat), learning_rate=rate)
        name = "frame head, epoch"
        if not minimize(
            network, objects, steps, HEAD_EPOCHS, name, report, should_stop
        ):
            return None
    write_arrays(file, {name: value.numpy() for name, value in head.items()})
    return network


def _steps(
    network: GroundingNetwork,
    sampler: ImageSampler,
    stage: _Stage,
    config: GroundingConfig,
    losses: Callable[[LabelledImages, Tensor], tuple[Tensor, Tensor]],
    number: int,
) -> Iterator[Step]:
    """Draw the images of a round and yield the losses of its gradient steps."""
    labels = sampler.sample(config.images)
    if number == 1 and stage.recognizes:
        positions = labels.grasp_position.flatten(0, -2)
        network.position_mean.copy_(positions.mean(0))
        network.position_std.copy_(positions.std(0).clamp(min=1e-3))
    for rows in torch.arange(config.images).split(config.batch):
        yield len(rows), *losses(labels, rows)


def _progress(
    file: Path, sampler: ImageSampler, generator: torch.Generator
) -> PassProgress:
    """Return where a stage that is stopped continues, beside the file of its result."""

    def get_state() -> dict[str, np.ndarray]:
        return {"generator": generator.get_state().numpy(), **sampler.get_state()}

    def set_state(state: dict[str, np.ndarray]) -> None:
        generator.set_state(torch.from_numpy(state.pop("generator")))
        sampler.set_state(state)

    return PassProgress(file.with_suffix(".part.npz"), get_state, set_state)


def _parameters(
    network: GroundingNetwork, beginnings: tuple[str, ...]
) -> dict[str, Tensor]:
    """Return the parameters and buffers whose names begin so."""
    state = network.state_dict().items()
    return {name: value for name, value in state if name.startswith(beginnings)}


def _copy(arrays: dict[str, np.ndarray] | None, parameters: dict[str, Tensor]) -> bool:
    """Copy cached arrays into parameters; return whether they fit."""
    if arrays is None:
        return False
    cached = {name: array.shape for name, array in arrays.items()}
    needed = {name: tuple(value.shape) for name, value in parameters.items()}
    if cached != needed:
        return False
    for name, value in parameters.items():
        value.copy_(torch.from_numpy(arrays[name]))
    return True
