"""Snapshots of the shared parameters go in; results of the interim evaluation come out."""

import os
from collections.abc import Callable
from multiprocessing.connection import Connection

import torch

from knowarm.learn.a3c.messages import Evaluation, Snapshot
from knowarm.learn.flat import FlatParameters
from knowarm.learn.processes import prepare_process
from knowarm.learn.trainer import Evaluate
from knowarm.policy import Policy, PolicyConfig

MakeEvaluate = Callable[[], Evaluate]
"""Makes the function that plays the fixed episodes; picklable."""


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
