"""Training of one experiment in its run folder, from the start or resumed."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from dataclasses import replace as replace_fields
from pathlib import Path
from typing import Any

from knowarm.config import replace, to_dict
from knowarm.errors import UserError
from knowarm.experiment.algorithms import ALGORITHMS, TrainerInputs
from knowarm.experiment.build import (
    SEED_DERIVATION,
    EnvFactory,
    InterimFactory,
    Parts,
    build,
    slots_of,
)
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.grounding_training import train_grounding
from knowarm.experiment.logs import Mirror, RunLogs, TrainingProgress
from knowarm.experiment.migration import FORMAT, migrate_checkpoints
from knowarm.experiment.perceived import FILE, describe_module, perception_for, stored_perception
from knowarm.experiment.perception import check_fits, read_module
from knowarm.experiment.registry import experiment_config
from knowarm.experiment.run_folder import RunFolder, provenance, writing
from knowarm.experiment.run_lock import lock_folder
from knowarm.learn import CheckpointStore, Hooks, Trainer, TrainingResult
from knowarm.policy import Policy
from knowarm.world.scene import list_facets, scene_of

BEFORE_FIRST_STEP = -1
"""Step before every row of the curves: resuming from it drops them all."""


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
    """Return the folder of one run: ``<runs>/<experiment>/<seed>``."""
    return runs / config.name / str(config.seed)


def train(
    config: ExperimentConfig | str,
    runs: Path | str = "runs",
    *,
    resume: bool = False,
    should_stop: Callable[[], bool] = lambda: False,
    mirrors: Sequence[Mirror] = (),
    perception: Path | str | None = None,
    **overrides: Any,
) -> Run:
    """Train one experiment, or resume a training that was stopped.

    Args:
        config: the experiment's name, such as ``"irb120-full-fast"``, or its config. To resume a
            run, pass what it was started with; only ``total_steps`` may differ.
        runs: folder of all runs; this one is stored in ``<runs>/<experiment>/<seed>/``.
        resume: continue from the run's latest intact checkpoint instead of refusing a folder that
            holds a run; a run that ended before its first checkpoint starts from the beginning.
        should_stop: called between updates; true saves a checkpoint and ends the training.
        mirrors: further places that receive the curves, beside CSV files and TensorBoard.
        perception: file of the perception module, for knowledge of what is perceived; the run
            folder keeps a copy, with which it resumes.
        **overrides: fields of the config to change; a nested config takes a mapping of its fields,
            such as ``algorithm={"num_envs": 64}``.

    Returns:
        The run folder and how the training ended.

    Raises:
        UserError: an unknown experiment or field, or a run folder that already exists, is missing,
            cannot be written to, is in use by another process, or belongs to another config.
    """
    if isinstance(config, str):
        config = experiment_config(config)
    config = replace(config, overrides) if overrides else config
    path = run_path(Path(runs), config)
    if resume:
        _check_same(config, RunFolder.open(path))
    module = _perception(config, RunFolder(path) if resume else None, perception)
    parts = build(config)
    with lock_folder(path, remedy="Wait until it ends, stop it, or pass another runs folder."):
        return _train_locked(config, parts, module, path, resume, should_stop, mirrors)


def _perception(
    config: ExperimentConfig, resumed: RunFolder | None, given: Path | str | None
) -> bytes | None:
    """Return the content of the perception module of a run; None where none is needed.

    Raises:
        UserError: none is given where one is needed or the reverse, it does not fit the task, or a
            resumed run was trained with another one.
    """
    data = None if given is None else read_module(Path(given))
    path = None if given is None else Path(given)
    if resumed is not None and (resumed.path / FILE).exists():
        stored = stored_perception(resumed)
        if data is not None and data != stored:
            raise UserError(
                f"{resumed.path} was trained with another perception module than {given}. Resume "
                "without perception, or pass another runs folder or seed to start a new run."
            )
        data, path = stored, resumed.path / FILE
    if config.grounding is not None and given is None:
        return data  # trained with the run where there is none yet
    perception = perception_for(config.knowledge, data, path or Path(FILE))
    if perception is not None:
        check_fits(
            perception.seen, config.env, list_facets(scene_of(config.env), config.env.colours)
        )
    return data


def _train_locked(
    config: ExperimentConfig,
    parts: Parts,
    module: bytes | None,
    path: Path,
    resume: bool,
    should_stop: Callable[[], bool],
    mirrors: Sequence[Mirror],
) -> Run:
    """Train in a run folder that no other process writes to; see `train`."""
    if resume:
        folder = RunFolder.open(path)
        folder.write_json("config.json", {"format": FORMAT, **to_dict(config)})
        migrate_checkpoints(folder.checkpoints, config.env.robot)
        if folder.has_checkpoint:
            parts = replace_fields(parts, table=folder.knowledge())
    else:
        folder = RunFolder.create(path)
    policy = parts.new_policy(config.seed)
    with TrainingProgress(f"{config.name}/{config.seed}", config.total_steps) as progress:
        for line in announcements(parts):
            progress.line(line)
        if config.grounding is not None and module is None:
            folder.write_json("config.json", {"format": FORMAT, **to_dict(config)})  # can resume
            module = _train_grounding(config, parts, progress.line, should_stop)
            if module is None:
                stopped = TrainingResult(step=0, reason="stopped", best_return=None, best_step=None)
                return Run(folder, stopped)
        logs = RunLogs(folder, progress, mirrors)
        trainer = _make_trainer(config, parts, policy, module, folder, logs, should_stop)
        if not (resume and folder.has_checkpoint):
            # Written after the trainer is built: a config that this machine cannot train leaves
            # no run behind.
            _describe(folder, config, parts, module)
        keep_to_step = None
        if resume and folder.has_checkpoint:
            trainer.resume()
            progress.line(f"resuming at step {trainer.step:,}")
            keep_to_step = trainer.step
        elif resume:
            progress.line("no checkpoint yet: starting from the beginning")
            keep_to_step = BEFORE_FIRST_STEP
        logs.open(keep_to_step=keep_to_step, pending=trainer.pending_evaluations.keys())
        try:
            result = trainer.train(config.total_steps)
        finally:
            logs.close()
        if (step := folder.ended_early_at(config.stop_when)) is not None:
            progress.line(f"learned, as stop_when defines it, at step {step:,}")
            result = replace_fields(result, reason="finished")
    return Run(folder, result)


def _train_grounding(
    config: ExperimentConfig,
    parts: Parts,
    report: Callable[[str], None],
    should_stop: Callable[[], bool],
) -> bytes | None:
    """Train the grounding network of a run; return the content of its file, None if stopped."""
    assert config.grounding is not None
    network = train_grounding(
        config.env,
        parts.table,
        slots_of(parts.embedding),
        config.grounding,
        seed=config.seed,
        report=report,
        should_stop=should_stop,
    )
    return None if network is None else network.to_bytes()


def announcements(parts: Parts) -> list[str]:
    """Describe the policy network and its knowledge vector in a few lines for the terminal."""
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
        lines.append("the knowledge identifies the episode's target: privileged information")
    return [*lines, *([embedding.note] if embedding.note else [])]


def description(config: ExperimentConfig, parts: Parts) -> dict[str, Any]:
    """Describe what a checkpoint belongs to, as flat values; others are refused on resuming."""
    # The capacity control is described by its resolved sizes, as in format 1.
    choices = to_dict(parts.new_policy(0).resolved_config)
    del choices["wide"]
    return {
        "robot": config.env.robot,
        "agent": config.agent,
        "algorithm": config.algorithm.name,
        "seed": config.seed,
        **_flat(choices, "policy.config."),
        **_flat(to_dict(parts.policy_shape), "policy.shape."),
    }


def _describe(
    folder: RunFolder, config: ExperimentConfig, parts: Parts, module: bytes | None
) -> None:
    """Write provenance, knowledge table, perception module and config before the first step."""
    policy = parts.new_policy(config.seed)
    folder.write_json(
        "provenance.json",
        {
            **provenance(),
            "seed_derivation": SEED_DERIVATION,
            "parameter_counts": policy.parameter_counts(),
            "policy": {
                "config": to_dict(policy.resolved_config),
                "shape": to_dict(parts.policy_shape),
            },
            "facets": [list(facet) for facet in parts.facets],
            "knowledge": parts.embedding.describe(),
            **({} if module is None else {"perception": describe_module(module)}),
        },
    )
    if module is not None:
        with writing(folder.path / FILE):
            (folder.path / FILE).write_bytes(module)
    folder.write_knowledge(parts.table)
    folder.write_json("config.json", {"format": FORMAT, **to_dict(config)})


def _check_same(config: ExperimentConfig, folder: RunFolder) -> None:
    """Refuse to resume with another config than the run's, and list the differing fields.

    Only ``total_steps`` may change, to make a run longer.
    """
    different = differences(folder.experiment(), config)
    different.pop("total_steps", None)
    if different:
        raise UserError(
            f"{folder.path} was started with another config (run | given): "
            f"{'; '.join(different.values())}. Resume without "
            "these overrides, or pass another runs folder or seed to start a new run."
        )


def differences(run: ExperimentConfig, given: ExperimentConfig) -> dict[str, str]:
    """Return the fields in which two configs differ, each with "field: value | value"."""
    before, now = _flat(to_dict(run)), _flat(to_dict(given))
    return {
        name: f"{name}: {before.get(name)!r} | {now.get(name)!r}"
        for name in {**before, **now}
        if before.get(name) != now.get(name)
    }


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{prefix}{name}.")
        else:
            flat[prefix + name] = value
    return flat


def _make_trainer(
    config: ExperimentConfig,
    parts: Parts,
    policy: Policy,
    module: bytes | None,
    folder: RunFolder,
    logs: RunLogs,
    should_stop: Callable[[], bool],
) -> Trainer:

    def should_end() -> bool:
        return should_stop() or folder.ended_early_at(config.stop_when) is not None

    hooks = Hooks(on_metrics=logs.metrics, on_evaluation=logs.evaluation, should_stop=should_end)
    inputs = TrainerInputs(
        config=config.algorithm,
        policy=policy,
        make_env=EnvFactory(config.env, module),
        make_evaluate=InterimFactory(config.env, config.interim, config.seed, module),
        options={
            "seed": config.seed,
            "evaluate_every": config.interim.every_steps,
            "hooks": hooks,
            "checkpoints": CheckpointStore(folder.checkpoints, description(config, parts)),
            "checkpoint_every": config.checkpoint_every_steps,
            "failure_folder": folder.path / "failure",
        },
    )
    return ALGORITHMS[config.algorithm.name].make_trainer(inputs)
