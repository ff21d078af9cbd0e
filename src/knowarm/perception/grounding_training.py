"""Training of grounding networks on images of the simulator, with a cache of the results."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim import Adam
from torch.optim.lr_scheduler import OneCycleLR

from knowarm.cores import torch_threads
from knowarm.learn.checkpoint import Tensors, prefixed, select, to_arrays, to_tensors
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
from knowarm.seeding import derive_seed, torch_generator
from knowarm.world.cache import cache_file, read_arrays, write_arrays
from knowarm.world.config import EnvConfig

Step = tuple[int, Tensor, Tensor]
"""Number of images of a gradient step, the loss that is minimized, and the one that is reported."""

Report = Callable[[str], None]
"""Receives a line of text."""

ShouldStop = Callable[[], bool]
"""Called at every gradient step; true ends the training."""

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

SEEING = ("encoder.", "position_")
"""How the names of parameters begin on which a frame head depends."""
FRAME_HEAD = ("frame.",)
"""How those of a frame head begin."""
RECOGNIZING = SEEING + FRAME_HEAD
"""How those begin that recognize names and grasp frames."""
COMPARING = ("key.", "query.")
"""How those begin that compare queries with places."""


class _Stage(NamedTuple):
    """A part of a training."""

    name: str
    rounds: int
    trained: tuple[str, ...]  # How the names of the parameters begin that it trains


def train_grounding(
    env: EnvConfig,
    knowledge: np.ndarray,
    slots: int,
    config: GroundingConfig,
    *,
    seed: int,
    report: Report = lambda text: None,
    should_stop: ShouldStop = lambda: False,
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

    def losses(stage: _Stage, labels: LabelledImages) -> tuple[Tensor, Tensor]:
        """Compute for some images the loss that is minimized and the one that is reported."""
        features = network.features(labels.images, bfloat16)
        weighted = []
        if stage.trained != RECOGNIZING:
            queries = torch.randperm(len(vectors), generator=generator)[:QUERIES]
            asked = vectors[queries], answers.of(queries)
            place = network.place_loss(features, labels, *asked, bfloat16=bfloat16)
            weighted.append((1.0, place))
        if stage.trained != COMPARING:
            naming, frame = network.recognition_losses(features.float(), labels)
            weighted += [(config.naming_coef, naming), (FRAME_COEF, frame)]
        total = sum(weight * loss for weight, loss in weighted)
        return cast(Tensor, total), weighted[0][1]

    def steps(stage: _Stage, sampler: ImageSampler, number: int) -> Iterator[Step]:
        """Draw the images of a round and yield the losses of its gradient steps."""
        labels = sampler.sample(config.images)
        if number == 1 and stage.trained != COMPARING:
            positions = labels.grasp_position.flatten(0, -2)
            network.position_mean.copy_(positions.mean(0))
            network.position_std.copy_(positions.std(0).clamp(min=1e-3))
        for rows in torch.arange(config.images).split(config.batch):
            yield len(rows), *losses(stage, labels.of(rows))

    images_alone = config
    stages = [_Stage("everything", config.rounds, RECOGNIZING + COMPARING)]
    if config.shared_rounds > 0:
        # So that agents with other rounds share the first stage.
        images_alone = replace(config, rounds=0)
        stages = [
            _Stage("names and frames", config.shared_rounds, RECOGNIZING),
            _Stage("queries", config.rounds, COMPARING),
        ]
    versions = (REVISION, version("torch"), bfloat16)
    depends_on: list[object] = [*versions, env, images_alone, seed]
    for number, stage in enumerate(stages):
        if stage.rounds == 0:
            continue
        path = (number,) if number > 0 else ()
        stream = derive_seed(seed, "perception", GROUNDING_IMAGES, *path)
        first = sample_images(env, spec, KEYED_IMAGES, stream)
        depends_on += [stage.rounds, *[tensor.numpy() for tensor in first]]
        if stage.trained != RECOGNIZING:
            table = (answers.satisfies.numpy(), answers.askable.numpy())
            depends_on += [knowledge, slots, *table]
        file = cache_file("grounding", *depends_on)
        if _read(file, network, stage.trained):
            report(f"grounding network ({stage.name}): read from {file}")
            continue
        report(
            f"training the grounding network ({stage.name}) on {stage.rounds} x "
            f"{config.images:,} images"
        )
        with torch_threads(1):
            sampler = ImageSampler(env, spec, stream)
            progress = PassProgress(file.with_suffix(".part.npz"), sampler, generator)
            is_finished = minimize(
                network,
                config,
                partial(steps, stage, sampler),
                stage.rounds,
                "grounding, round",
                report,
                should_stop,
                progress,
            )
        if not is_finished:
            return None
        _write(file, network, stage.trained)
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
    report: Report = lambda text: None,
    should_stop: ShouldStop = lambda: False,
) -> GroundingNetwork | None:
    """Return a network with a new frame head, trained on the features of a trained network.

    Names, keys and queries stay as they are. Arguments as `train_grounding`.
    """
    spec = trained.spec
    network = GroundingNetwork(spec, trained.knowledge, trained.slots, seed=seed)
    kept = _parameters(trained, SEEING + COMPARING)
    network.load_state_dict(kept, strict=False)
    inputs_of_head = to_arrays(_parameters(trained, SEEING))
    depends_on = (REVISION, version("torch"), env, config, seed)
    file = cache_file("grounding", *depends_on, *inputs_of_head.values())
    if _read(file, network, FRAME_HEAD):
        report(f"grounding network (frame head): read from {file}")
        return network.eval().requires_grad_(False)
    report(f"training the grounding network (frame head) on {config.images:,} images")
    stream = derive_seed(seed, "perception", GROUNDING_IMAGES, HEAD)
    generator = torch_generator(seed, "perception", GROUNDING_IMAGES, HEAD)
    with torch_threads(1):
        labels = sample_images(env, spec, config.images, stream)
        places = place_of(labels.pixels, spec.image_size)

        def inputs_of(images: Tensor, places: Tensor) -> Tensor:
            return network.frame_inputs(network.encoder.features(images), places)

        inputs = in_batches(inputs_of, labels.images, places).flatten(0, 1)
        part = network.part_of[labels.facets].flatten()
        frames = network.standardized(labels.grasp_position, labels.grasp_axes)
        frames = frames.flatten(0, 1)
        cast(Standardize, network.frame[0]).fit(inputs)

        def steps(number: int) -> Iterator[Step]:
            order = torch.randperm(len(inputs), generator=generator)
            for rows in order.split(config.batch):
                predicted = network.frames_of(inputs[rows], part[rows])
                loss = (predicted - frames[rows]).square().mean()
                yield len(rows), loss, loss

        rate = HEAD_RATE * config.learning_rate
        objects = replace(config, images=len(inputs), learning_rate=rate)
        name = "frame head, epoch"
        if not minimize(
            network, objects, steps, HEAD_EPOCHS, name, report, should_stop
        ):
            return None
    _write(file, network, FRAME_HEAD)
    return network


def _parameters(network: GroundingNetwork, beginnings: tuple[str, ...]) -> Tensors:
    """Return the parameters and buffers whose names begin so."""
    state = network.state_dict().items()
    return {name: value for name, value in state if name.startswith(beginnings)}


def _write(file: Path, network: GroundingNetwork, trained: tuple[str, ...]) -> None:
    """Store the parameters whose names begin so in the cache."""
    write_arrays(file, to_arrays(_parameters(network, trained)))


def _read(file: Path, network: GroundingNetwork, trained: tuple[str, ...]) -> bool:
    """Read the parameters whose names begin so from the cache, or let them alone be trained.

    Returns whether the cache had them.
    """
    cached = to_tensors(read_arrays(file) or {})
    if _shapes(cached) == _shapes(_parameters(network, trained)):
        network.load_state_dict(cached, strict=False)
        return True
    for name, parameter in network.named_parameters():
        parameter.requires_grad_(name.startswith(trained))
    return False


def _shapes(tensors: Tensors) -> dict[str, torch.Size]:
    return {name: value.shape for name, value in tensors.items()}


@dataclass(frozen=True)
class PassProgress:
    """A file in the user's cache with the state of `minimize` after its last whole pass."""

    file: Path
    sampler: ImageSampler  # draws the images of the steps
    generator: torch.Generator  # draws all else

    def save(
        self, number: int, module: nn.Module, optimizer: Adam, schedule: OneCycleLR
    ) -> None:
        """Store the state after a pass."""
        group = optimizer.param_groups[0]
        arrays = {
            "number": np.array(number),
            "rate": np.array([group["lr"], *group["betas"]]),
            "step": np.array(schedule.last_epoch),
            **prefixed("module/", to_arrays(module.state_dict())),
        }
        for index, moments in optimizer.state_dict()["state"].items():
            arrays |= prefixed(f"adam/{index}/", to_arrays(moments))
        arrays["draws/generator"] = self.generator.get_state().numpy()
        write_arrays(self.file, arrays | prefixed("draws/", self.sampler.get_state()))

    def restore(self, module: nn.Module, optimizer: Adam, schedule: OneCycleLR) -> int:
        """Restore the stored state, if there is one; return the number of passes done."""
        arrays = read_arrays(self.file)
        if arrays is None:
            return 0
        module.load_state_dict(to_tensors(select(arrays, "module/")))
        state = optimizer.state_dict()
        for index in state["param_groups"][0]["params"]:
            state["state"][index] = to_tensors(select(arrays, f"adam/{index}/"))
        optimizer.load_state_dict(state)
        rate, *betas = arrays["rate"].tolist()
        optimizer.param_groups[0].update(lr=rate, betas=tuple(betas))
        schedule.last_epoch = int(arrays["step"])
        draws = select(arrays, "draws/")
        self.generator.set_state(torch.from_numpy(draws.pop("generator")))
        self.sampler.set_state(draws)
        return int(arrays["number"])


def minimize(
    module: nn.Module,
    config: GroundingConfig,
    steps: Callable[[int], Iterator[Step]],
    passes: int,
    name: str,
    report: Report,
    should_stop: ShouldStop,
    progress: PassProgress | None = None,
) -> bool:
    """Minimize the losses of each pass's steps with Adam; return whether it was not stopped.

    Parameters that need no gradient stay as they are. With ``progress`` a minimization that was
    stopped continues after its last whole pass, as if it had not been stopped.
    """
    count = -(-config.images // config.batch) * passes
    trained = [
        parameter for parameter in module.parameters() if parameter.requires_grad
    ]
    optimizer = Adam(trained, config.learning_rate)
    schedule = OneCycleLR(optimizer, config.learning_rate, total_steps=max(2, count))
    passes_done = 0
    if progress is not None:
        passes_done = progress.restore(module, optimizer, schedule)
    if passes_done:
        report(f"{name} {passes_done} of {passes}: done before")
    for number in range(passes_done + 1, passes + 1):
        total = 0.0
        for images, loss, reported in steps(number):
            if should_stop():
                return False
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
            total += float(reported.detach()) * images
        report(f"{name} {number} of {passes}: loss {total / config.images:.3f}")
        if progress is not None:
            progress.save(number, module, optimizer, schedule)
    module.eval().requires_grad_(False)
    return True
