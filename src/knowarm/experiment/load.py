"""Loading of trained agents from run folders."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from knowarm.config import from_dict
from knowarm.errors import UserError
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.run_folder import RunFolder
from knowarm.learn.checkpoint import read_checkpoint
from knowarm.policy import Policy, PolicyConfig
from knowarm.policy.agent import PolicyAgent

Which = Literal["best", "latest", "untrained"]
"""Policy of a run: of the best interim evaluation, the latest, or the initial weights."""


@dataclass(frozen=True)
class TrainedAgent:
    """A trained agent and its origin.

    Attributes:
        agent: plays episodes.
        policy: its network.
        knowledge: (F, K) float32, the policy's knowledge vector for each facet.
        config: the experiment that trained it.
        folder: its run folder.
        step: environment steps it was trained for.
        which: which of the run's policies it is.
    """

    agent: PolicyAgent
    policy: Policy
    knowledge: np.ndarray
    config: ExperimentConfig
    folder: RunFolder
    step: int
    which: Which


def load_agent(
    path: Path | str, *, which: Which = "best", greedy: bool = True, seed: int = 0
) -> TrainedAgent:
    """Load the trained agent of a run.

    Args:
        path: the run folder, such as ``runs/irb120-full-ppo/0``.
        which: the policy of the best interim evaluation, the latest policy, or the initial
            weights.
        greedy: take the most probable action instead of sampling one.
        seed: seed of the sampled actions.

    Returns:
        The agent with its policy, config and run folder.

    Raises:
        UserError: the folder holds no run, no such checkpoint, or a damaged one.
    """
    folder = RunFolder.open(path)
    config = folder.experiment()
    described = folder.provenance()["policy"]
    sizes = from_dict(PolicyConfig, {**described["config"], **described["shape"]}, where="policy")
    policy = Policy(sizes, seed=config.seed)
    step = 0
    if which != "untrained":
        checkpoint = read_checkpoint(folder.checkpoints / which)
        step = int(checkpoint.facts["step"])
        _load_parameters(policy, checkpoint.policy, folder.checkpoints / which)
    policy.eval()
    table = folder.knowledge()
    agent = PolicyAgent(policy, table, greedy=greedy, generator=torch.Generator().manual_seed(seed))
    return TrainedAgent(agent, policy, table, config, folder, step, which)


def _load_parameters(policy: Policy, arrays: dict[str, np.ndarray], where: Path) -> None:
    """Copy parameters into the policy after comparing names and shapes."""
    expected = {name: tuple(value.shape) for name, value in policy.state_dict().items()}
    found = {name: value.shape for name, value in arrays.items()}
    if expected != found:
        different = sorted(
            name for name in {*expected, *found} if expected.get(name) != found.get(name)
        )
        pairs = "; ".join(f"{n}: {found.get(n)} | {expected.get(n)}" for n in different)
        raise UserError(
            f"The checkpoint {where} does not fit the policy of its run folder (checkpoint | "
            f"policy): {pairs}. One of the two was replaced: restore it."
        )
    policy.load_state_dict({name: torch.from_numpy(value) for name, value in arrays.items()})
