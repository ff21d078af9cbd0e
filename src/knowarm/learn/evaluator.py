"""Snapshots of a policy's parameters go in; results of the interim evaluation come out."""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection

import numpy as np
import torch

from knowarm.learn.flat import FlatParameters
from knowarm.learn.processes import prepare_process
from knowarm.learn.trainer import Evaluate, Metrics
from knowarm.policy import Policy, PolicyConfig

MakeEvaluate = Callable[[], Evaluate]
"""Makes the function that plays the fixed episodes; picklable."""


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """To the evaluator: the parameters when interim evaluation ``number`` was due."""

    number: int
    step: int
    values: np.ndarray


@dataclass(frozen=True, kw_only=True)
class Evaluation:
    """From the evaluator: results of a `Snapshot`."""

    number: int
    results: Metrics = field(default_factory=dict)


def run_evaluator(
    policy_config: PolicyConfig, make_evaluate: MakeEvaluate, connection: Connection
) -> None:
    """Entry point of the evaluator process: evaluate snapshots until the trainer is gone."""
    prepare_process()
    policy = Policy(policy_config)
    flat = FlatParameters(policy)
    evaluate = make_evaluate()
    try:
        while True:
            snapshot: Snapshot = connection.recv()
            flat.values.copy_(torch.from_numpy(snapshot.values))
            connection.send(Evaluation(number=snapshot.number, results=evaluate(policy)))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        os._exit(0)
