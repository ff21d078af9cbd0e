"""What a caller gave to ``step`` goes in; an error comes out if it is wrong."""

from typing import Any

import torch
from torch import Tensor

from knowarm.errors import UserError


def check_actions(actions: Any, targets: Tensor, levels: int) -> None:
    """Refuse actions that do not fit, as far as that can be told without waiting for a GPU.

    Args:
        actions: what was given.
        targets: the joint targets that actions add to, (n, J), on the environment's device.
        levels: number of levels a joint has.

    Raises:
        UserError: no int64 tensor (n, J) on the same device; on the CPU also a number outside 0 to
            levels - 1.
    """
    shape, device = tuple(targets.shape), targets.device
    wanted = f"actions must be an int64 tensor of shape {shape} (environments, joints) on {device}"
    if not isinstance(actions, Tensor):
        raise UserError(f"{wanted}, got {type(actions).__name__}.")
    if (tuple(actions.shape), actions.dtype, actions.device) != (shape, torch.int64, device):
        raise UserError(
            f"{wanted}, got {actions.dtype} of shape {tuple(actions.shape)} on {actions.device}."
        )
    if device.type == "cpu" and (actions.min() < 0 or actions.max() >= levels):
        raise UserError(
            f"actions must lie in 0 to {levels - 1}, got {int(actions.min())} to "
            f"{int(actions.max())}."
        )
