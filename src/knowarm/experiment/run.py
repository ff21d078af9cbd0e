"""An experiment's config goes in; a run folder with its curves and checkpoints comes out."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from knowarm.config import from_dict, to_dict
from knowarm.errors import UserError
from knowarm.experiment.build import InterimFactory, Parts, TorchEnvFactory, build
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.logs import RunLogs
from knowarm.experiment.migration import FORMAT
from knowarm.experiment.progress import TrainingProgress
from knowarm.experiment.provenance import provenance
from knowarm.experiment.run_folder import RunFolder
from knowarm.learn.a3c import A3CTrainer
from knowarm.learn.checkpoint import CheckpointStore
from knowarm.learn.config import A3CConfig
from knowarm.learn.ppo import PPOTrainer
from knowarm.learn.trainer import Hooks, TrainingResult
from knowarm.policy import Policy

SEED_STRIDE = 2**32
"""Between the streams of two training seeds: environment i of a run takes stream seed + i, and
neighbouring seeds must not share episodes."""


BEFORE_EVERYTHING = -1
"""A step that drops every row of the curves."""


@dataclass(frozen=True)
class Run:
    """A training that ended.

    Attributes:
        folder: its run folder.
        result: how it ended.
    """

    folder: RunFolder
    result: TrainingResult


def run_path(runs: Path, config: ExperimentConfig) -> Path:
    """Folder of one run: ``<runs>/<experiment>/<seed>``."""
    return runs / config.name / str(config.seed)


def train(
    config: ExperimentConfig,
    runs: Path,
    *,
    resume: bool = False,
    should_stop: Callable[[], bool] = lambda: False,
) -> Run:
    """Train one experiment, or go on with it.

    Args:
        config: the experiment; when resuming it must be what the run began with.
        runs: folder of all runs.
        resume: go on from the run's latest whole checkpoint instead of refusing a folder that
            holds a run; one that ended before its first checkpoint begins anew.
        should_stop: asked between updates; true saves a checkpoint and ends the training.

    Raises:
        UserError: the folder is taken, missing, not writable or of another config.
    """
    path = run_path(runs, config)
    if resume:
        _check_same(config, RunFolder.open(path))
    parts = build(config)
    if resume:
        folder = RunFolder.open(path)
        folder.write_json("config.json", {"format": FORMAT, **to_dict(config)})
    else:
        folder = RunFolder.create(path)
    policy = parts.new_policy(config.seed)
    label = f"{config.name}/{config.seed}"
    with TrainingProgress(label, config.total_steps) as progress:
        for line in announcements(parts):
            progress.say(line)
        logs = RunLogs(folder, progress)
        trainer = _trainer(config, parts, policy, folder, logs, should_stop)
        if not resume:
            # Not before: what this machine cannot train must not leave a run behind.
            _describe(folder, config, parts)
        keep_to_step = None
        if resume and folder.has_checkpoint:
            trainer.resume()
            progress.say(f"going on at step {trainer.step:,}")
            keep_to_step = trainer.step
        elif resume:
            progress.say("it ended before its first checkpoint: beginning anew")
            keep_to_step = BEFORE_EVERYTHING
        logs.open(keep_to_step=keep_to_step)
        try:
            result = trainer.train(config.total_steps)
        finally:
            logs.close()
    return Run(folder, result)


def stored_config(folder: RunFolder) -> ExperimentConfig:
    """Read the config a run began with."""
    values = {name: value for name, value in folder.config().items() if name != "format"}
    return from_dict(ExperimentConfig, values)


def announcements(parts: Parts) -> list[str]:
    """What a person should know about the network and its knowledge before training."""
    counts = parts.new_policy(0).parameter_counts()
    groups = ", ".join(f"{name} {n:,}" for name, n in counts.items() if name != "total" and n)
    lines = [f"{counts['total']:,} parameters ({groups})"]
    if not parts.table.shape[1]:
        return [*lines, "no knowledge vector"]
    embedding = parts.embedding
    lines.append(f"knowledge: {parts.table.shape[1]} numbers, norm {embedding.norm:.3f}")
    if embedding.constant:
        lines.append(
            "the knowledge vector is the same in every episode: a constant input, which the "
            "network can only use as a bias; compare with the controls (knowarm list)"
        )
    if embedding.privileged:
        lines.append("the knowledge names the episode's target: privileged information")
    return [*lines, *([embedding.note] if embedding.note else [])]


def description(config: ExperimentConfig, parts: Parts) -> dict[str, Any]:
    """What a checkpoint belongs to, as flat values; another description is refused."""
    # The capacity control resolved, as in format 1: its checkpoints stay resumable.
    sizes = to_dict(parts.new_policy(0).resolved_config) | to_dict(parts.policy_shape)
    network = {f"network.{name}": value for name, value in sizes.items() if name != "wide"}
    return {
        "robot": config.env.robot,
        "agent": config.agent,
        "algorithm": config.algorithm.name,
        "seed": config.seed,
        **network,
    }


def _describe(folder: RunFolder, config: ExperimentConfig, parts: Parts) -> None:
    """Write what the run depends on, before the first step."""
    policy = parts.new_policy(config.seed)
    folder.write_json(
        "provenance.json",
        {
            **provenance(),
            "parameter_counts": policy.parameter_counts(),
            "network": {
                "config": to_dict(parts.policy_config),
                "shape": to_dict(parts.policy_shape),
            },
            "facets": [list(facet) for facet in parts.facets],
            "knowledge": parts.embedding.describe(),
        },
    )
    folder.write_knowledge(parts.table)
    folder.write_json("config.json", {"format": FORMAT, **to_dict(config)})


def _check_same(config: ExperimentConfig, folder: RunFolder) -> None:
    """Refuse to go on with another config than the run began with, naming the fields.

    Only ``total_steps`` may change: a run may be made longer.
    """
    before, now = _flat(to_dict(stored_config(folder))), _flat(to_dict(config))
    different = [name for name in {**before, **now} if before.get(name) != now.get(name)]
    different = [name for name in different if name != "total_steps"]
    if different:
        pairs = "; ".join(f"{name}: {before.get(name)!r} | {now.get(name)!r}" for name in different)
        raise UserError(
            f"{folder.path} began with another config (run | asked for): {pairs}. Resume without "
            "these overrides, or start a new run with another --runs folder or --seed."
        )


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{prefix}{name}.")
        else:
            flat[prefix + name] = value
    return flat


def _trainer(
    config: ExperimentConfig,
    parts: Parts,
    policy: Policy,
    folder: RunFolder,
    logs: RunLogs,
    should_stop: Callable[[], bool],
) -> PPOTrainer | A3CTrainer:
    common: dict[str, Any] = {
        "seed": SEED_STRIDE * config.seed,
        "evaluate_every": config.interim.every_steps,
        "hooks": Hooks(
            on_metrics=logs.metrics, on_evaluation=logs.evaluation, should_stop=should_stop
        ),
        "checkpoints": CheckpointStore(folder.checkpoints, description(config, parts)),
        "checkpoint_every": config.checkpoint_every_steps,
        "failure_folder": folder.path / "failure",
    }
    make_env = TorchEnvFactory(config.env)
    make_evaluate = InterimFactory(config.env, config.interim)
    algorithm = config.algorithm
    if isinstance(algorithm, A3CConfig):
        return A3CTrainer(algorithm, policy, make_env, make_evaluate=make_evaluate, **common)
    if algorithm.device == "cpu":
        env = make_env(algorithm.num_envs)
        return PPOTrainer(algorithm, policy, env, evaluate=make_evaluate(), **common)
    # Warp takes seconds to import.
    from knowarm.world.gpu.env import DeviceReachVectorEnv

    on_gpu = DeviceReachVectorEnv(config.env, algorithm.num_envs, algorithm.device)
    # The interim episodes are played on the CPU: alone on a GPU they would take as long.
    return PPOTrainer(algorithm, policy, on_gpu, make_evaluate=make_evaluate, **common)
