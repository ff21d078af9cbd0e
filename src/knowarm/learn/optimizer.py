"""Optimizers: Adam, or Muon for the hidden layers' matrices; precision of its products."""

from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor

import torch
from torch import Tensor, nn

from knowarm.learn.algorithms import MinibatchConfig, Precision
from knowarm.learn.checkpoint import Arrays, prefixed, select, to_arrays, to_tensors
from knowarm.policy import MatmulPrecision
from knowarm.private_apis import cpu_has_bfloat16, without_compiler

Adam = without_compiler(torch.optim.Adam)
Muon = without_compiler(torch.optim.Muon)

NEWTON_SCHULZ = (3.4445, -4.775, 2.0315)
"""Coefficients of the quintic iteration of Muon (Jordan 2024)."""
MOMENTUM = 0.95
ADAM_EPS = 1e-5


class Float32Muon(torch.optim.Optimizer):
    """Muon with products in float32.

    PyTorch's Muon computes in bfloat16. Without bfloat16 in hardware that takes fourteen times as
    long as float32 (docs/lab-notes.md). The update is scaled to the root mean square of Adam's.
    """

    def __init__(
        self,
        parameters: Iterable[nn.Parameter],
        lr: float,
        iterations: int = 5,
    ) -> None:
        super().__init__(parameters, {"lr": lr})
        self._iterations = iterations

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # type: ignore[override]
        """Update every parameter from its gradient."""
        for group in self.param_groups:
            for parameter in group["params"]:
                gradient = parameter.grad
                state = self.state[parameter]
                if not state:
                    state["momentum_buffer"] = torch.zeros_like(parameter)
                average = state["momentum_buffer"].lerp_(gradient, 1 - MOMENTUM)
                update = gradient.lerp(average, MOMENTUM).flatten(1)
                scale = 0.2 * max(update.shape) ** 0.5
                update = orthogonalized(update, self._iterations).view_as(parameter)
                parameter.add_(update, alpha=-group["lr"] * scale)


def orthogonalized(matrix: Tensor, iterations: int) -> Tensor:
    """Return the nearly orthogonal matrix with the singular vectors of a matrix (m, n).

    An iteration multiplies by a polynomial of the square of the matrix, x x' (k, k) with k the
    smaller side. All polynomials commute, so their product is computed with (k, k) matrices only.
    """
    if matrix.shape[0] > matrix.shape[1]:
        return orthogonalized(matrix.T, iterations).T
    a, b, c = NEWTON_SCHULZ
    x = matrix / matrix.norm().clamp(min=1e-7)
    gram = x @ x.T
    product = None
    for i in range(iterations):
        factor = torch.addmm(gram, gram, gram, beta=b, alpha=c)
        factor.diagonal().add_(a)
        product = factor if product is None else product @ factor
        if i + 1 < iterations:
            gram = factor @ gram @ factor
    return x if product is None else product @ x


MUON_PARAMETERS: dict[str, tuple[str, ...]] = {
    "adam": (),
    "muon": ("fc.weight", "memory.weight_ih", "memory.weight_hh"),
    "muon-float32": ("fc.weight", "encoder.conv1.weight", "encoder.conv2.weight"),
}
"""Matrices and kernels that Muon updates, by ``optimizer``; Adam updates the others."""


class PolicyOptimizer:
    """One step of all parameters, with a common learning rate.

    Where several processes wait for the step, their cores are free, and a second thread updates a
    matrix; the bytes stay the same.
    """

    def __init__(
        self,
        parameters: Mapping[str, nn.Parameter],
        config: MinibatchConfig,
        processes: int = 1,
    ) -> None:
        self._parameters = parameters
        others = dict(parameters)
        muons = {}
        for name in MUON_PARAMETERS[config.optimizer]:
            muons[name] = _muon(others.pop(name), config)
        adam = Adam(others.values(), lr=config.learning_rate, eps=ADAM_EPS, fused=True)
        self._optimizers = [adam, *muons.values()]
        self._optimizer_of = dict.fromkeys(others, adam) | muons
        self._pool = None
        if muons and processes > 1:
            self._pool = ThreadPoolExecutor(1)

    def set_learning_rate(self, rate: float) -> None:
        """Set the learning rate of the following steps."""
        for optimizer in self._optimizers:
            for group in optimizer.param_groups:
                group["lr"] = rate

    def step(self) -> None:
        """Update the parameters from their gradients."""
        if self._pool is None:
            for optimizer in self._optimizers:
                optimizer.step()
            return
        *others, last = self._optimizers
        update = self._pool.submit(last.step)
        for optimizer in others:
            optimizer.step()
        update.result()

    def get_state(self) -> Arrays:
        """Return the state as arrays named ``<parameter>/<quantity>``."""
        arrays: Arrays = {}
        for name, parameter in self._parameters.items():
            state = self._optimizer_of[name].state.get(parameter, {})
            arrays |= prefixed(f"{name}/", to_arrays(state))
        return arrays

    def set_state(self, state: Arrays) -> None:
        """Continue from the result of `get_state`."""
        for name, parameter in self._parameters.items():
            tensors = to_tensors(select(state, f"{name}/"), parameter.device)
            self._optimizer_of[name].state[parameter] = tensors


def _muon(matrix: nn.Parameter, config: MinibatchConfig) -> torch.optim.Optimizer:
    """Return the optimizer of one matrix; its updates have the size of Adam's."""
    rate = config.learning_rate
    if config.optimizer == "muon-float32":
        return Float32Muon([matrix], rate, iterations=3)
    if resolve_precision("auto", matrix.device) == "float32":
        return Float32Muon([matrix], rate)
    return Muon([matrix], rate, weight_decay=0.0, adjust_lr_fn="match_rms_adamw")


def resolve_precision(choice: Precision, device: torch.device) -> MatmulPrecision:
    """Return the precision that a choice means on a device.

    "auto" is bfloat16 where the device computes it in hardware, else float32.
    """
    if choice != "auto":
        return choice
    is_fast = (
        cpu_has_bfloat16() if device.type == "cpu" else torch.cuda.is_bf16_supported()
    )
    return "bfloat16" if is_fast else "float32"
