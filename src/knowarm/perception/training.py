"""Minimization of a network's losses in passes, which can be stopped and continued."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim import Adam
from torch.optim.lr_scheduler import OneCycleLR

from knowarm.learn.checkpoint import select
from knowarm.perception.config import GroundingConfig
from knowarm.world.cache import read_arrays, write_arrays

Step = tuple[int, Tensor, Tensor]
"""Number of images of a gradient step, the loss that is minimized, and the one that is reported."""


@dataclass(frozen=True)
class PassProgress:
    """A file in the user's cache with the state of `minimize` after its last whole pass."""

    file: Path
    get_state: Callable[[], dict[str, np.ndarray]]  # of all that draws the steps
    set_state: Callable[[dict[str, np.ndarray]], None]

    def save(
        self, number: int, module: nn.Module, optimizer: Adam, schedule: OneCycleLR
    ) -> None:
        """Store the state after a pass."""
        group = optimizer.param_groups[0]
        arrays = {
            "number": np.array(number),
            "rate": np.array([group["lr"], *group["betas"]]),
            "step": np.array(schedule.last_epoch),
        }
        for name, value in module.state_dict().items():
            arrays[f"module/{name}"] = value.numpy()
        for index, moments in optimizer.state_dict()["state"].items():
            for name, value in moments.items():
                arrays[f"adam/{index}/{name}"] = value.numpy()
        for name, array in self.get_state().items():
            arrays[f"draws/{name}"] = array
        write_arrays(self.file, arrays)

    def restore(self, module: nn.Module, optimizer: Adam, schedule: OneCycleLR) -> int:
        """Restore the stored state, if there is one; return the number of passes done."""
        arrays = read_arrays(self.file)
        if arrays is None:
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
        schedule.load_state_dict(
            {**schedule.state_dict(), "last_epoch": int(arrays["step"])}
        )
        self.set_state(select(arrays, "draws/"))
        return int(arrays["number"])


def minimize(
    module: nn.Module,
    config: GroundingConfig,
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
