"""A run folder goes in; the agent it trained comes out, ready to play."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import torch

from knowarm.config import from_dict
from knowarm.errors import UserError
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.migration import migrate_policy
from knowarm.experiment.run import stored_config
from knowarm.experiment.run_folder import RunFolder
from knowarm.learn.checkpoint import read_checkpoint
from knowarm.policy import Policy, PolicyAgent, PolicyConfig, PolicyShape

Which = Literal["best", "latest", "untrained"]


@dataclass(frozen=True)
class TrainedAgent:
    """An agent and where it comes from.

    Attributes:
        agent: plays episodes.
        policy: its network.
        knowledge: (F, K) float32, what the network is given in an episode of each facet.
        config: the experiment that trained it.
        folder: its run folder.
        step: environment steps it was trained for.
    """

    agent: PolicyAgent
    policy: Policy
    knowledge: np.ndarray
    config: ExperimentConfig
    folder: RunFolder
    step: int


def load_agent(
    path: Path | str, *, which: Which = "best", greedy: bool = True, seed: int = 0
) -> TrainedAgent:
    """Load the agent of a run.

    Args:
        path: the run folder.
        which: the policy of the best interim evaluation, the latest, or the weights the
            training began with.
        greedy: take the most probable action instead of drawing one.
        seed: of the drawn actions.

    Raises:
        UserError: the folder holds no run, no such checkpoint, or a damaged one.
    """
    folder = RunFolder.open(path)
    config = stored_config(folder)
    stored = migrate_policy(folder.provenance()["network"])
    table = folder.knowledge()
    policy = Policy(
        from_dict(PolicyConfig, stored["config"], where="network.config"),
        from_dict(PolicyShape, stored["shape"], where="network.shape"),
        table,
        seed=config.seed,
    )
    step = 0
    if which != "untrained":
        checkpoint = read_checkpoint(folder.checkpoints / which)
        step = int(checkpoint.facts["step"])
        _fill(policy, checkpoint.policy, folder.checkpoints / which)
    policy.eval()
    agent = PolicyAgent(policy, greedy=greedy, generator=torch.Generator().manual_seed(seed))
    return TrainedAgent(agent, policy, table, config, folder, step)


def _fill(policy: Policy, arrays: dict[str, np.ndarray], where: Path) -> None:
    """Copy parameters into the policy, comparing names and shapes first."""
    wanted = {name: tuple(value.shape) for name, value in policy.state_dict().items()}
    found = {name: value.shape for name, value in arrays.items()}
    if wanted != found:
        different = sorted(
            name for name in {*wanted, *found} if wanted.get(name) != found.get(name)
        )
        pairs = "; ".join(f"{n}: {found.get(n)} | {wanted.get(n)}" for n in different)
        raise UserError(
            f"The checkpoint {where} does not fit the network of its run folder (checkpoint | "
            f"network): {pairs}. One of the two was replaced: restore it."
        )
    policy.load_state_dict({name: torch.from_numpy(value) for name, value in arrays.items()})
