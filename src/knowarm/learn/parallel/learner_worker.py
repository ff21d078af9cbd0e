"""Learner worker: process that computes a part of each inference step and minibatch gradient."""

from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from knowarm.learn.algorithms import PPOConfig
from knowarm.learn.losses import PPOLossTerms
from knowarm.learn.minibatch import TrainingNetwork, add_gradient, buffer_specs, buffers
from knowarm.learn.parallel.flat_parameters import FlatParameters
from knowarm.learn.parallel.shared_tensors import SharedTensors, TensorSpecs
from knowarm.learn.rollout import Rollout, infer_step
from knowarm.policy import MatmulPrecision, Policy, PolicySpec


class InferCommand(NamedTuple):
    """To a worker: run the policy for step ``t`` of the environments ``envs``."""

    t: int
    envs: slice


class GradientCommand(NamedTuple):
    """To a worker: compute the gradient over ``env_ids``, weighted; see `add_gradient`."""

    env_ids: np.ndarray
    weight: float


def shared_specs(network: TrainingNetwork, config: PPOConfig, processes: int) -> TensorSpecs:
    """Return shapes and dtypes of the tensors that trainer and workers share."""
    policy, count = network.policy, config.num_envs
    shape = policy.shape
    parameters = sum(p.numel() for p in network.parameters())
    return {
        **buffer_specs(network, config),
        "parameters": ((parameters,), torch.float32),
        "gradients": ((processes, parameters), torch.float32),
        "terms": ((processes, len(PPOLossTerms.names())), torch.float32),
        "image": ((count, shape.image_size, shape.image_size, 3), torch.uint8),
        "h": ((count, policy.hidden_size), torch.float32),
        "c": ((count, policy.hidden_size), torch.float32),
        "logits": ((count, shape.joints, shape.levels), torch.float32),
    }


def infer_shared(
    policy: Policy, rollout: Rollout, shared: SharedTensors, t: int, image: Tensor, envs: slice
) -> None:
    """Run the policy for step t of ``envs``; recurrent states and logits are shared tensors."""
    state = (shared["h"], shared["c"])
    logits, (h, c) = infer_step(policy, rollout, t, image, state, envs)
    shared["logits"][envs] = logits
    shared["h"][envs] = h
    shared["c"][envs] = c


def run_learner_worker(
    spec: PolicySpec,
    auxiliary_targets: int,
    config: PPOConfig,
    precision: MatmulPrecision,
    shared: SharedTensors,
    index: int,
    connection: Connection,
) -> None:
    """Entry point of a learner worker: execute commands until the parent process exits.

    Every command is answered with true once its results are in shared memory.
    """
    policy = spec.build()
    policy.matmul_precision = precision
    network = TrainingNetwork(policy, auxiliary_targets)
    gradient = shared["gradients"][index]
    FlatParameters(network, shared["parameters"], gradient, keep_values=False)
    rollout, targets = buffers(shared.tensors)
    while True:
        command = connection.recv()
        if isinstance(command, InferCommand):
            infer_shared(policy, rollout, shared, command.t, shared["image"], command.envs)
        else:
            gradient.zero_()
            env_ids = torch.from_numpy(command.env_ids)
            terms = add_gradient(network, config, rollout, targets, env_ids, command.weight)
            shared["terms"][index] = terms.vector()
        connection.send(True)
