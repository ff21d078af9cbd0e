"""Optimizer of PPO: Adam, or Muon for the hidden layers' matrices; precision of its products."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Literal

import numpy as np
import torch
from torch import nn

from knowarm.learn.algorithms import PPOConfig
from knowarm.learn.checkpoint import select
from knowarm.policy import MatmulPrecision
from knowarm.private_apis import cpu_has_bfloat16, without_compiler

Adam = without_compiler(torch.optim.Adam)
Muon = without_compiler(torch.optim.Muon)

MUON_PARAMETERS = ("fc.weight", "memory.weight_ih", "memory.weight_hh")
"""Matrices that Muon updates: those of the hidden layers."""


class PolicyOptimizer:
    """One step of all parameters, with a common learning rate.

    Where several processes wait for the step, their cores are free, and a second thread updates a
    matrix; the bytes stay the same.
    """

    def __init__(
        self, parameters: Mapping[str, nn.Parameter], config: PPOConfig, processes: int = 1
    ) -> None:
        self._parameters = parameters
        matrices = [parameters[name] for name in MUON_PARAMETERS if config.optimizer == "muon"]
        others = [p for p in parameters.values() if not any(p is matrix for matrix in matrices)]
        self._optimizers: list[torch.optim.Optimizer] = [
            Adam(others, lr=config.learning_rate, eps=config.adam_eps, fused=True)
        ]
        # This scale gives updates of the size of Adam's, so that both share a learning rate.
        self._optimizers += [
            Muon([each], lr=config.learning_rate, weight_decay=0.0, adjust_lr_fn="match_rms_adamw")
            for each in matrices
        ]
        self._pool = ThreadPoolExecutor(1) if matrices and processes > 1 else None

    def set_learning_rate(self, rate: float) -> None:
        """Set the learning rate of the following steps."""
        for optimizer in self._optimizers:
            for group in optimizer.param_groups:
                group["lr"] = rate

    def step(self) -> None:
        """Update the parameters from their gradients."""
        *most, last = self._optimizers
        updated = None if self._pool is None else self._pool.submit(last.step)
        for optimizer in most:
            optimizer.step()
        if updated is None:
            last.step()
        else:
            updated.result()

    def get_state(self) -> dict[str, np.ndarray]:
        """Return the state as arrays named ``<parameter>/<quantity>``."""
        return {
            f"{name}/{key}": value.cpu().numpy().copy()
            for name, parameter in self._parameters.items()
            for optimizer in self._optimizers
            if parameter in optimizer.state
            for key, value in optimizer.state[parameter].items()
        }

    def set_state(self, state: Mapping[str, np.ndarray]) -> None:
        """Continue from the result of `get_state`."""
        for name, parameter in self._parameters.items():
            arrays = select(state, f"{name}/").items()
            values = {key: torch.from_numpy(value).to(parameter.device) for key, value in arrays}
            for optimizer in self._optimizers:
                if any(parameter is p for p in optimizer.param_groups[0]["params"]):
                    optimizer.state[parameter] = values


PrecisionChoice = Literal["auto"] | MatmulPrecision


def resolve_precision(choice: PrecisionChoice, device: torch.device) -> MatmulPrecision:
    """Return the precision that a choice means on a device.

    "auto" is bfloat16 where the device computes it in hardware, else float32.
    """
    if choice != "auto":
        return choice
    is_fast = cpu_has_bfloat16() if device.type == "cpu" else torch.cuda.is_bf16_supported()
    return "bfloat16" if is_fast else "float32"
