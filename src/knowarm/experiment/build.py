"""Parts of an experiment: built from its config, or loaded from its run folder."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from knowarm.config import from_dict
from knowarm.errors import UserError
from knowarm.experiment.config import ExperimentConfig, InterimConfig
from knowarm.experiment.grounding import FRAME, Grounding
from knowarm.experiment.perceived import (
    FILE,
    PerceivingAgent,
    PerceivingVectorEnv,
    module_of,
    perception_for,
    stored_perception,
)
from knowarm.experiment.perception import Perception, read_module
from knowarm.experiment.run_folder import RunFolder
from knowarm.knowledge.embedding import SceneEmbedding, scene_embedding
from knowarm.knowledge.query_embedding import query_embedding
from knowarm.learn import TorchVectorEnv, read_checkpoint
from knowarm.policy import Policy, PolicyAgent, PolicyConfig, PolicyShape
from knowarm.reading import reading
from knowarm.seeding import torch_generator
from knowarm.world.config import EnvConfig
from knowarm.world.episodes import evaluation_episodes
from knowarm.world.play import EpisodeResults, play
from knowarm.world.tasks.reach import ACTION_LEVELS
from knowarm.world.torch_env import TorchReachVectorEnv
from knowarm.world.vector_env import ReachVectorEnv

SEED_DERIVATION = "seed sequence"
"""Value of ``seed_derivation`` in ``provenance.json``. Runs of earlier versions have none: their
weights were drawn from the seed itself."""

Which = Literal["best", "latest", "untrained"]
"""Policy of a run: of the best interim evaluation, the latest, or the initial weights."""


@dataclass(frozen=True)
class EnvFactory:
    """Factory of training environments; picklable, so that worker processes can call it.

    Attributes:
        config: the task.
        perception: content of the perception module's file, for knowledge of what is perceived.
    """

    config: EnvConfig
    perception: bytes | None = None

    def __call__(
        self, num_envs: int, num_threads: int = 0, *, device: str = "cpu"
    ) -> TorchVectorEnv:
        """Make ``num_envs`` environments on a device, with ``num_threads`` threads (0: all)."""
        options: dict[str, Any] = {"device": device, "num_threads": num_threads}
        if self.perception is None:
            return TorchReachVectorEnv(self.config, num_envs, **options)
        perception = module_of(self.perception)
        return PerceivingVectorEnv(self.config, num_envs, perception, **options)


@dataclass(frozen=True)
class Parts:
    """The knowledge of an experiment and the configuration of its policy.

    Attributes:
        embedding: the scene embedding with its names, coverage and norm.
        table: (F, K) float32, the knowledge vector for each facet, or for each query.
        policy_config: choices of the policy.
        policy_shape: input and output sizes of the policy.
        facets: the environment's F (object, colour) pairs, one per row of the table.
    """

    embedding: SceneEmbedding
    table: np.ndarray
    policy_config: PolicyConfig
    policy_shape: PolicyShape
    facets: tuple[tuple[str, str], ...]
    grounded: bool = False
    """Whether the policy is told what a grounding network finds instead of a row of the table."""

    def new_policy(self, seed: int) -> Policy:
        """Initialize a policy; the same seed gives the same weights."""
        table = None if self.grounded else self.table
        return Policy(self.policy_config, self.policy_shape, table, seed=seed)


def build(config: ExperimentConfig) -> Parts:
    """Compute the knowledge table of an experiment and the shape of its policy.

    The table has a row per facet, or per query where the task asks, unless the knowledge is of
    what is perceived.

    Raises:
        UserError: the graph lacks an object, or the sizes do not fit together.
    """
    env = ReachVectorEnv(config.env, 1)
    embedding: SceneEmbedding
    if env.queries and config.knowledge.scope != "perceived":
        embedding = query_embedding(config.knowledge, env.queries, run_seed=config.seed)
        table = embedding.table(env.queries)
    else:
        embedding = scene_embedding(config.knowledge, env.facets, run_seed=config.seed)
        table = embedding.table(env.facets)
    grounded = config.grounding is not None
    shape = PolicyShape(
        joints=env.scene.num_joints,
        levels=len(ACTION_LEVELS),
        image_size=config.env.image_size,
        knowledge_dim=FRAME if grounded else embedding.dim,
        knowledge_slots=1 if grounded else slots_of(embedding),
    )
    policy = config.policy if embedding.dim else replace(config.policy, fusion="none")
    if config.knowledge.source.encoder != policy.knowledge_encoder == "identity":
        raise UserError(
            f"The knowledge source {config.knowledge.source.short_name!r} has no meaning of its "
            "own: set policy.knowledge_encoder to 'learned'."
        )
    if policy.wide:
        table = table[:, :0]
    return Parts(embedding, table, policy, shape, env.facets, grounded)


def slots_of(embedding: SceneEmbedding) -> int:
    """Return the number of equal parts of a knowledge vector, at least 1."""
    return max(1, embedding.dim // max(1, embedding.slot_dim))


@dataclass(frozen=True)
class InterimFactory:
    """Factory of the function that plays the interim evaluation.

    It is picklable, so that the evaluating process can call it.

    Attributes:
        env: the task, with the success thresholds of training.
        interim: number and seed of the episodes.
        seed: of the run; sampled actions depend on it, the episodes do not.
        perception: content of the perception module's file, for knowledge of what is perceived.
    """

    env: EnvConfig
    interim: InterimConfig
    seed: int
    perception: bytes | None = None

    def __call__(self) -> Callable[[Policy], dict[str, float]]:
        """Make the environments, draw the episodes, and return the evaluating function."""
        interim = self.interim
        env = ReachVectorEnv(self.env, interim.episodes)
        episodes = evaluation_episodes(env.scene, self.env, interim.episodes, interim.seed)
        data = self.perception
        perception = None if data is None else module_of(data)

        def evaluate(policy: Policy) -> dict[str, float]:
            generator = torch_generator(self.seed, "interim_actions")
            agent = policy_agent(policy, perception, interim.greedy, generator)
            result = play(agent, env, episodes)
            numbers = interim_numbers(result, self.env.success_distance_m)
            if env.queries:  # ended nearest to the wanted object
                numbers["choice"] = float((result.chosen == result.target).mean())
            return numbers

        return evaluate


def policy_agent(
    policy: Policy, perception: Perception | None, greedy: bool, generator: torch.Generator
) -> PolicyAgent:
    """Return the agent that plays with a policy, and with a perception module where it has one."""
    options: dict[str, Any] = {"greedy": greedy, "generator": generator}
    if perception is None:
        return PolicyAgent(policy, **options)
    return PerceivingAgent(perception, policy, **options)


def interim_numbers(result: EpisodeResults, success_distance_m: float) -> dict[str, float]:
    """Average the episodes of one interim evaluation, at the success thresholds of training.

    Args:
        result: the played episodes.
        success_distance_m: largest distance that counts for ``accuracy`` [m].

    Returns:
        Column of ``evaluations.csv`` to value: ``accuracy`` counts the distance only (paper
        equation 8), ``success`` distance and orientation.
    """
    return {
        "return_mean": float(result.episode_return.mean()),
        "return_std": float(result.episode_return.std()),
        "length_mean": float(result.length.mean()),
        "success": float(result.success.mean()),
        "accuracy": float((result.distance <= success_distance_m).mean()),
        "distance_mean": float(result.distance.mean()),
        "angle_mean": float(result.angle.mean()),
    }


@dataclass(frozen=True)
class TrainedAgent:
    """A trained agent and its origin.

    Attributes:
        agent: plays episodes.
        policy: its network, with the knowledge table.
        config: the experiment that trained it.
        folder: its run folder.
        step: environment steps it was trained for.
        which: which of the run's policies it is.
    """

    agent: PolicyAgent
    policy: Policy
    config: ExperimentConfig
    folder: RunFolder
    step: int
    which: Which

    def tell(self, knowledge: torch.Tensor) -> torch.Tensor:
        """Replace the knowledge table (F, K) of grounding network or policy; return the old one."""
        module = self.agent.perception if isinstance(self.agent, PerceivingAgent) else None
        if isinstance(module, Grounding):
            before, module.knowledge = module.knowledge, knowledge.to(module.knowledge.device)
        else:
            table = self.policy.knowledge_table
            before, self.policy.knowledge_table = table, knowledge.to(table.device)
        return before


def load_agent(
    path: Path | str,
    *,
    which: Which = "best",
    greedy: bool = True,
    seed: int = 0,
    perception: Path | str | None = None,
) -> TrainedAgent:
    """Load the trained agent of a run.

    Args:
        path: the run folder, such as ``runs/irb120-full-fast/0``.
        which: the policy of the best interim evaluation, the latest policy, or the initial
            weights.
        greedy: take the most probable action instead of sampling one.
        seed: seed of the sampled actions.
        perception: file of another perception module than the one that the run folder keeps.

    Returns:
        The agent with its policy, config and run folder.

    Raises:
        UserError: the folder holds no run, no such checkpoint, or a damaged one.
    """
    folder = RunFolder.open(path)
    config = folder.experiment()
    provenance = folder.provenance()
    checkpoint = None if which == "untrained" else read_checkpoint(folder.checkpoints / which)
    table = folder.knowledge()
    with reading(folder.path / "provenance.json", "Restore the file."):
        stored = provenance["policy"]
        choices = from_dict(PolicyConfig, stored["config"], where="policy.config")
        if choices.wide and checkpoint:
            choices = _sizes_of_checkpoint(choices, checkpoint.policy)
        shape = from_dict(PolicyShape, stored["shape"], where="policy.shape")
        policy = Policy(choices, shape, None if config.grounding else table, seed=config.seed)
    step = 0
    if checkpoint:
        step = int(checkpoint.facts["step"])
        _load_parameters(policy, checkpoint.policy, folder.checkpoints / which)
    elif "seed_derivation" not in provenance:
        policy.reset_parameters(torch.Generator().manual_seed(config.seed))
    policy.eval()
    generator = torch.Generator().manual_seed(seed)
    agent = policy_agent(policy, _perception(folder, config, perception), greedy, generator)
    return TrainedAgent(agent, policy, config, folder, step, which)


def _perception(
    folder: RunFolder, config: ExperimentConfig, given: Path | str | None
) -> Perception | None:
    """Return the given perception module, or that of the run; None where none is needed."""
    if given is not None:
        return perception_for(config.knowledge, read_module(Path(given)), Path(given))
    if not config.has_module:
        return None
    return module_of(stored_perception(folder), folder.path / FILE)


def _sizes_of_checkpoint(config: PolicyConfig, arrays: dict[str, np.ndarray]) -> PolicyConfig:
    """Return the sizes of a capacity control whose run stored only that it is one.

    Earlier versions did, and computed other sizes.
    """
    features, hidden = arrays["fc.weight"].shape[0], arrays["memory.weight_hh"].shape[1]
    return replace(config, wide=False, fusion="none", features=features, hidden=hidden)


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
