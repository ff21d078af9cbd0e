"""Gradients of every worker by itself, from one backward pass over the rollouts of all."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn

from knowarm.learn.checkpoint import Tensors
from knowarm.learn.losses import Terms
from knowarm.learn.rollout import Rollout
from knowarm.policy import Policy, State


class WorkerGradients:
    """Gradients of W workers that share a policy and play one environment each.

    The loss is a sum over workers, so its gradient with respect to what a layer computes splits by
    worker, and the gradient of the layer's weights is a product of that with the layer's inputs for
    each worker. `infer` keeps what the image encoder computes while the workers play.

    Args:
        policy: the policy.
        steps: T, steps of a rollout at most.
        workers: W.

    Attributes:
        rollout: written by a collector that uses `infer`.
        gradients: (W, ...) by name of the parameter, after `compute`.
    """

    def __init__(self, policy: Policy, steps: int, workers: int) -> None:
        self.policy = policy
        encoder = policy.encoder
        shape = (workers, steps)
        # A worker's images are contiguous, as the products of each worker need them.
        self._patches = torch.zeros(*shape, *encoder.patch_shape, dtype=torch.uint8)
        with torch.no_grad(), policy.autocast():
            blank = encoder.first(self._patches[0, :1], encoder.product_weights())
        self._hidden = torch.zeros(*shape, *blank.shape[1:], dtype=blank.dtype)
        self._encoded = torch.zeros(*shape, encoder.width)
        rollout = Rollout.zeros(steps, workers, policy)
        self.rollout = replace(rollout, patches=self._patches.transpose(0, 1))
        self.gradients: Tensors = {}

    def infer(
        self,
        rollout: Rollout,
        t: int,
        image: Tensor,
        state: State,
    ) -> tuple[Tensor, State]:
        """Run the policy for step t, as `infer_step`."""
        policy = self.policy
        encoder = policy.encoder
        if t == 0:
            self._weights = encoder.product_weights()
        patches = policy.patches(image)
        with policy.autocast():
            hidden = encoder.first(patches, self._weights)
            encoded = encoder.second(hidden, self._weights)
        self._patches[:, t] = patches
        self._hidden[:, t] = hidden
        self._encoded[:, t] = encoded
        logits, values, state = policy.step(
            encoded, rollout.knowledge[t], state, rollout.episode_start[t]
        )
        rollout.value[t] = values
        return logits, state

    def compute(self, count: int, loss: Callable[[Tensor], Terms]) -> Terms:
        """Compute the gradients of a loss over the first ``count`` steps of the rollout.

        Args:
            count: t, the number of steps.
            loss: computes it from the encoded images (t, W, width).

        Returns:
            The loss and its terms.
        """
        policy = self.policy
        self.gradients = {}
        self._count = count
        encoded = self._encoded[:, :count].transpose(0, 1).contiguous().requires_grad_()
        with self._taps():
            terms = loss(encoded)
            terms["total"].backward()
        assert encoded.grad is not None
        # Worker by worker, because that is what fits into the processor's cache.
        kept = (self._patches, self._hidden, self._encoded)
        inputs = [tensor[:, :count] for tensor in kept]
        by_worker = zip(*inputs, encoded.grad.transpose(0, 1), strict=True)
        of_workers = [policy.encoder.gradients(*tensors) for tensors in by_worker]
        for name in of_workers[0]:
            stacked = torch.stack([of_worker[name] for of_worker in of_workers])
            self.gradients[f"encoder.{name}"] = stacked
        return terms

    @contextmanager
    def _taps(self) -> Iterator[None]:
        """Watch the layers, whose weights get no gradients from the backward pass meanwhile."""
        policy = self.policy
        memory = policy.memory
        projected: list[Tensor] = []
        hooks = [
            memory.projected.register_forward_hook(
                lambda _, args, y: projected.append(y)
            ),
            memory.register_forward_hook(partial(self._tap_memory, projected)),
        ]
        for name, layer in policy.named_modules():
            if isinstance(layer, nn.Linear):
                tap = partial(self._tap_linear, name)
                hooks.append(layer.register_forward_hook(tap))
        policy.requires_grad_(False)
        try:
            yield
        finally:
            policy.requires_grad_(True)
            for hook in hooks:
                hook.remove()

    def _tap_linear(
        self,
        name: str,
        layer: nn.Linear,
        args: tuple[Any, ...],
        y: Tensor,
    ) -> None:
        def add(gradient: Tensor) -> None:
            of_outputs = self._by_worker(gradient)
            self.gradients[f"{name}.weight"] = _products(
                of_outputs, self._by_worker(args[0])
            )
            if layer.bias is not None:
                self.gradients[f"{name}.bias"] = of_outputs.float().sum(1)

        y.requires_grad_().register_hook(add)

    def _tap_memory(
        self,
        projected: list[Tensor],
        memory: nn.Module,
        args: tuple[Any, ...],
        result: tuple[Tensor, State],
    ) -> None:
        x, (h, _), episode_start = args
        hidden = result[0].detach()
        before = torch.cat((h[None], hidden[:-1]))
        before *= ~episode_start[:, :, None]

        def add(gradient: Tensor) -> None:
            of_gates = self._by_worker(gradient)
            bias = of_gates.float().sum(1)
            self.gradients |= {
                "memory.weight_ih": _products(of_gates, self._by_worker(x)),
                "memory.weight_hh": _products(of_gates, self._by_worker(before)),
                "memory.bias_ih": bias,
                "memory.bias_hh": bias,
            }

        projected.pop().register_hook(add)

    def _by_worker(self, x: Tensor) -> Tensor:
        """Sort the rows of steps and workers by worker: (t * W * r, n) -> (W, t * r, n)."""
        workers = len(self._patches)
        rows = x.detach().reshape(self._count, workers, -1, x.shape[-1])
        return rows.transpose(0, 1).flatten(1, 2)


def _products(gradients: Tensor, inputs: Tensor) -> Tensor:
    """Compute each worker's gradient of a weight from (W, m, out) and (W, m, in): (W, out, in)."""
    return torch.bmm(gradients.transpose(1, 2), inputs.to(gradients.dtype)).float()
