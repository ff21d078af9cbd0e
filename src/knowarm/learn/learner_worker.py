"""Learner worker: process that computes a part of each inference step and minibatch gradient."""

import os
from dataclasses import dataclass
from multiprocessing.connection import Connection

import numpy as np
import torch
from torch import Tensor

from knowarm.learn.collector import infer_step
from knowarm.learn.config import PPOConfig
from knowarm.learn.flat_parameters import FlatParameters
from knowarm.learn.losses import PPOLossTerms
from knowarm.learn.minibatch import Targets, TrainingNetwork, add_gradient, target_specs
from knowarm.learn.processes import ProcessFailure, prepare_child_process
from knowarm.learn.rollout import Rollout, rollout_specs
from knowarm.learn.shared_tensors import SharedTensors, TensorSpecs
from knowarm.policy import MatmulPrecision, Policy, PolicySpec


@dataclass(frozen=True)
class LearnerWorkerArgs:
    """Arguments of a learner worker besides the shared memory."""

    policy: PolicySpec
    auxiliary_targets: int
    config: PPOConfig
    precision: MatmulPrecision


@dataclass(frozen=True)
class InferCommand:
    """To a worker: run the policy for step ``t`` of the environments ``envs``."""

    t: int
    envs: slice


@dataclass(frozen=True)
class GradientCommand:
    """To a worker: compute the gradient over ``env_ids``, weighted; see `add_gradient`."""

    env_ids: np.ndarray
    weight: float


@dataclass(frozen=True)
class CommandDone:
    """From a worker: the results of the command are in shared memory."""


def shared_specs(network: TrainingNetwork, config: PPOConfig, processes: int) -> TensorSpecs:
    """Return shapes and dtypes of the tensors that trainer and workers share."""
    policy, count = network.policy, config.num_envs
    shape = policy.shape
    parameters = sum(p.numel() for p in network.parameters())
    return {
        **rollout_specs(config.rollout_steps, count, policy),
        **target_specs(config.rollout_steps, count, network.auxiliary_targets),
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
    args: LearnerWorkerArgs, index: int, shared: SharedTensors, connection: Connection
) -> None:
    """Entry point of a learner worker: execute commands until the parent process exits."""
    prepare_child_process()
    try:
        _run(args, index, shared, connection)
    except (EOFError, BrokenPipeError, ConnectionResetError):
        os._exit(0)
    except Exception as error:
        connection.send(ProcessFailure.of(error))


def _run(
    args: LearnerWorkerArgs, index: int, shared: SharedTensors, connection: Connection
) -> None:
    config, policy = args.config, args.policy.build()
    policy.matmul_precision = args.precision
    network = TrainingNetwork(policy, args.auxiliary_targets)
    gradient = shared["gradients"][index]
    FlatParameters.bind(network, shared["parameters"], gradient)
    steps, count = config.rollout_steps, config.num_envs
    rollout = Rollout(**shared.select(rollout_specs(steps, count, policy)))
    targets = Targets(**shared.select(target_specs(steps, count, args.auxiliary_targets)))
    while True:
        command = connection.recv()
        if isinstance(command, InferCommand):
            infer_shared(policy, rollout, shared, command.t, shared["image"], command.envs)
        else:
            gradient.zero_()
            env_ids = torch.from_numpy(command.env_ids)
            terms = add_gradient(network, config, rollout, targets, env_ids, command.weight)
            shared["terms"][index] = terms.vector()
        connection.send(CommandDone())
