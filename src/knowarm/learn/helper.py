"""Commands of the trainer go in; parts of its rollouts and gradients appear in shared memory."""

import os
import traceback
from dataclasses import dataclass
from multiprocessing.connection import Connection

import numpy as np
import torch
from torch import Tensor

from knowarm.learn.config import PPOConfig
from knowarm.learn.flat import FlatParameters
from knowarm.learn.losses import PPOLossTerms
from knowarm.learn.minibatch import Targets, differentiate, target_shapes
from knowarm.learn.player import play_rows
from knowarm.learn.processes import prepare_process
from knowarm.learn.rollout import Rollout, rollout_shapes
from knowarm.learn.shared import Shapes, SharedTensors
from knowarm.policy import Policy, PolicyConfig
from knowarm.policy.policy import MatmulPrecision


@dataclass(frozen=True)
class HelperJob:
    """All a helper needs besides the shared memory."""

    policy: PolicyConfig
    config: PPOConfig
    table: np.ndarray
    precision: MatmulPrecision


@dataclass(frozen=True)
class Play:
    """To a helper: take step ``t`` of the environments ``rows``."""

    t: int
    rows: slice


@dataclass(frozen=True)
class Learn:
    """To a helper: compute the gradient of the environments ``columns``."""

    columns: np.ndarray
    share: float


@dataclass(frozen=True)
class Done:
    """From a helper: the command's results are in shared memory."""


@dataclass(frozen=True)
class Failure:
    """From a helper: it raised and ends."""

    traceback: str


def shared_shapes(policy: Policy, config: PPOConfig, processes: int) -> Shapes:
    """Shapes and types of everything the processes of a team share."""
    count, sizes = config.num_envs, policy.config
    parameters = sum(p.numel() for p in policy.parameters())
    image = (sizes.image_size, sizes.image_size, 3)
    return {
        **rollout_shapes(config.rollout_steps, count, policy),
        **target_shapes(config.rollout_steps, count),
        "parameters": ((parameters,), torch.float32),
        "gradients": ((processes, parameters), torch.float32),
        "terms": ((processes, len(PPOLossTerms.names())), torch.float32),
        "image": ((count, *image), torch.uint8),
        "h": ((count, sizes.hidden_size), torch.float32),
        "c": ((count, sizes.hidden_size), torch.float32),
        "logits": ((count, sizes.joints, sizes.levels), torch.float32),
    }


def write_play(
    policy: Policy,
    table: Tensor,
    rollout: Rollout,
    shared: SharedTensors,
    t: int,
    image: Tensor,
    rows: slice,
) -> None:
    """Take step t of the environments ``rows`` of images; states and results are shared."""
    state = (shared["h"], shared["c"])
    logits, (h, c) = play_rows(policy, table, rollout, t, image, state, rows)
    shared["logits"][rows] = logits
    shared["h"][rows] = h
    shared["c"][rows] = c


def run_helper(job: HelperJob, index: int, shared: SharedTensors, connection: Connection) -> None:
    """Entry point of a helper process: obey until the trainer is gone."""
    prepare_process()
    try:
        _obey(job, index, shared, connection)
    except (EOFError, BrokenPipeError, ConnectionResetError):
        os._exit(0)
    except Exception:
        connection.send(Failure(traceback.format_exc()))


def _obey(job: HelperJob, index: int, shared: SharedTensors, connection: Connection) -> None:
    config = job.config
    policy = Policy(job.policy)
    policy.matmul_precision = job.precision
    gradient = shared["gradients"][index]
    FlatParameters.at(policy, shared["parameters"], gradient)
    table = torch.tensor(job.table, dtype=torch.float32)
    steps, count = config.rollout_steps, config.num_envs
    rollout = Rollout(**shared.of(rollout_shapes(steps, count, policy)))
    targets = Targets(**shared.of(target_shapes(steps, count)))
    while True:
        command = connection.recv()
        if isinstance(command, Play):
            image = shared["image"]
            write_play(policy, table, rollout, shared, command.t, image, command.rows)
        else:
            gradient.zero_()
            columns = torch.from_numpy(command.columns)
            terms = differentiate(policy, config, table, rollout, targets, columns, command.share)
            shared["terms"][index] = terms.vector()
        connection.send(Done())
