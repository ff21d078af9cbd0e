"""Minimization of a network's losses in passes, which can be stopped and continued."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim import Adam
from torch.optim.lr_scheduler import OneCycleLR

from knowarm.learn.checkpoint import prefixed, select, to_arrays, to_tensors
from knowarm.perception.config import GroundingConfig
from knowarm.perception.images import ImageSampler
from knowarm.world.cache import read_arrays, write_arrays

Step = tuple[int, Tensor, Tensor]
"""Number of images of a gradient step, the loss that is minimized, and the one that is reported."""


Report = Callable[[str], None]
"""Receives a line of text."""

ShouldStop = Callable[[], bool]
"""Called at every gradient step; true ends the training."""


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
