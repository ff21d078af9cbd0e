"""Training of perception modules on images of the simulator, and of the facet classifier."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim import Adam
from torch.optim.lr_scheduler import OneCycleLR

from knowarm.cores import torch_threads
from knowarm.errors import UserError
from knowarm.learn.checkpoint import select
from knowarm.perception.classifier import FacetClassifier, accuracy
from knowarm.perception.config import GroundingConfig, ModuleSpec, PerceptionConfig
from knowarm.perception.images import sample_images
from knowarm.seeding import derive_seed, torch_generator
from knowarm.world.cache import read_arrays, write_arrays
from knowarm.world.config import EnvConfig
from knowarm.world.scene.appearance import VisualRandomization
from knowarm.world.tasks.held_out import HeldOut

LOOKS = VisualRandomization(
    light=0.3, light_angle_deg=20.0, camera_shift_m=0.02, camera_turn_deg=2.0, surface_colour=0.2
)
"""Visual randomization of the test."""

CLASSIFIER_IMAGES, TESTS, GROUNDING_IMAGES = range(3)
"""Numbers of the random streams of images."""

Step = tuple[int, Tensor, Tensor]
"""Number of images of a gradient step, the loss that is minimized, and the one that is reported."""


@torch_threads(1)
def train_classifier(
    env: EnvConfig, config: PerceptionConfig, *, report: Callable[[str], None] = lambda text: None
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

    minimize(classifier, config, epoch, config.epochs, "epoch", report)
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
    own = env.held_out or HeldOut(colours=colours)
    colours = tuple(dict.fromkeys((*own.colours, *colours)))
    return replace(env, held_out=replace(own, colours=colours))


@dataclass(frozen=True)
class PassProgress:
    """A file in the user's cache with the state of `minimize` after its last whole pass."""

    file: Path
    get_state: Callable[[], dict[str, np.ndarray]]  # of all that draws the steps
    set_state: Callable[[dict[str, np.ndarray]], None]

    def save(self, number: int, module: nn.Module, optimizer: Adam, schedule: OneCycleLR) -> None:
        """Store the state after a pass."""
        group = optimizer.param_groups[0]
        moments = optimizer.state_dict()["state"]
        write_arrays(
            self.file,
            {
                "number": np.array(number),
                "rate": np.array([group["lr"], *group["betas"]]),
                "step": np.array(schedule.last_epoch),
                **{f"module/{n}": value.numpy() for n, value in module.state_dict().items()},
                **{f"adam/{i}/{n}": v.numpy() for i, s in moments.items() for n, v in s.items()},
                **{f"draws/{n}": value for n, value in self.get_state().items()},
            },
        )

    def restore(self, module: nn.Module, optimizer: Adam, schedule: OneCycleLR) -> int:
        """Restore the stored state, if there is one; return the number of passes done."""
        if (arrays := read_arrays(self.file)) is None:
            return 0
        parameters = select(arrays, "module/").items()
        module.load_state_dict({n: torch.from_numpy(value) for n, value in parameters})
        moments: dict[int, dict[str, Tensor]] = {}
        for name, value in select(arrays, "adam/").items():
            index, _, key = name.partition("/")
            moments.setdefault(int(index), {})[key] = torch.from_numpy(value)
        optimizer.load_state_dict({**optimizer.state_dict(), "state": moments})
        rate, *betas = arrays["rate"].tolist()
        optimizer.param_groups[0].update(lr=rate, betas=tuple(betas))
        schedule.load_state_dict({**schedule.state_dict(), "last_epoch": int(arrays["step"])})
        self.set_state(select(arrays, "draws/"))
        return int(arrays["number"])


def minimize(
    module: nn.Module,
    config: PerceptionConfig | GroundingConfig,
    steps: Callable[[int], Iterator[Step]],
    passes: int,
    name: str,
    report: Callable[[str], None],
    should_stop: Callable[[], bool] = lambda: False,
    progress: PassProgress | None = None,
) -> bool:
    """Minimize the losses of each pass's steps with Adam; return whether it was not stopped.

    Parameters that need no gradient stay as they are. With ``progress`` a minimization that was
    stopped continues after its last whole pass, as if it had not been stopped.
    """
    count = -(-config.images // config.batch) * passes
    trained = [each for each in module.parameters() if each.requires_grad]
    optimizer = Adam(trained, config.learning_rate)
    schedule = OneCycleLR(optimizer, config.learning_rate, total_steps=max(2, count))
    done = progress.restore(module, optimizer, schedule) if progress is not None else 0
    if done:
        report(f"{name} {done} of {passes}: done before")
    for number in range(done + 1, passes + 1):
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
