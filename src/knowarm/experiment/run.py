"""Training of one experiment in its run folder, and the parts that its config describes."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from knowarm.config import differences, flatten, to_dict
from knowarm.errors import UserError
from knowarm.experiment.algorithms import algorithms
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.interim import interim_evaluation
from knowarm.experiment.knows import Knowledge
from knowarm.experiment.logs import RunLogs, TrainingProgress
from knowarm.experiment.names import experiment_config, override_experiment
from knowarm.experiment.provenance import provenance
from knowarm.experiment.run_folder import (
    PERCEPTION_FILE,
    RunFolder,
    check_network,
    network_for_training,
)
from knowarm.experiment.run_inputs import with_inputs
from knowarm.experiment.run_lock import lock_folder
from knowarm.learn import CheckpointStore, Hooks, Trainer, TrainingResult
from knowarm.perception.grounding import GroundingNetwork
from knowarm.perception.grounding_training import train_grounding
from knowarm.policy import Policy, PolicyConfig, PolicyShape
from knowarm.reading import digest, write_json
from knowarm.world.config import facets_of, robot_of
from knowarm.world.tasks.state import ACTION_LEVELS

BEFORE_FIRST_STEP = -1
"""Resuming from it drops all rows of the curves."""


class Run(NamedTuple):
    """A training that ended: its run folder, and how it ended."""

    folder: RunFolder  #: Its files; ``folder.path`` is the folder.
    result: TrainingResult  #: Steps, reason of the end, best interim evaluation.


@dataclass(frozen=True)
class Parts:
    """The knowledge of an experiment and the configuration of its policy."""

    knowledge: Knowledge
    """Without a grounding network, which is trained later."""
    policy_config: PolicyConfig
    policy_shape: PolicyShape

    def new_policy(self, seed: int) -> Policy:
        """Initialize a policy; the same seed gives the same weights."""
        return Policy(self.policy_config, self.policy_shape, seed=seed)


def run_path(runs: Path, config: ExperimentConfig) -> Path:
    """Return the folder of one run: ``<runs>/<experiment>/<seed>``."""
    return runs / config.name / str(config.seed)


def train(
    config: ExperimentConfig | str,
    runs: Path | str = "runs",
    *,
    resume: bool = False,
    should_stop: Callable[[], bool] = lambda: False,
    perception: Path | str | None = None,
    until_step: int | None = None,
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
        perception: file of a grounding network to use instead of training one; the run folder keeps
            a copy, with which it resumes.
        until_step: save a checkpoint and end at the first update that reaches this step, as
            ``should_stop`` does; schedules extend over ``total_steps`` all the same.
        **overrides: fields of the config to change; a nested config takes a mapping of its fields,
            such as ``algorithm={"num_envs": 64}``; ``graph`` is that of knowledge and questions.

    Returns:
        The run folder and how the training ended.

    Raises:
        UserError: an unknown experiment or field, or a run folder that already exists, is missing,
            cannot be written to, is in use by another process, or belongs to another config.
    """
    if isinstance(config, str):
        config = experiment_config(config, **overrides)
    elif overrides:
        config = override_experiment(config, overrides)
    if until_step is not None and until_step < 1:
        raise UserError(f"until_step must be at least 1, got {until_step}.")
    path = run_path(Path(runs), config)
    resumed = None
    if resume:
        resumed = RunFolder.open(path)
        different = other_fields(resumed, config)
        different.pop("total_steps", None)
        if different:
            raise UserError(
                f"{path} was started with another config (run | given): "
                f"{'; '.join(different.values())}. Resume without these overrides, or pass another "
                "runs folder or seed to start a new run."
            )
    network = network_for_training(config, resumed, perception)
    parts = build(config)
    if network is not None and not resume:
        check_network(config, network, parts.knowledge.table)
    remedy = "Wait until it ends, stop it, or pass another runs folder."
    with lock_folder(path, remedy=remedy) as lock:

        def should_end() -> bool:
            lock.check()
            return should_stop()

        folder = RunFolder.open(path) if resume else RunFolder.create(path)
        return _train(
            config, parts, network, folder, resume, should_end, until_step, lock.check
        )


def _train(
    config: ExperimentConfig,
    parts: Parts,
    network: GroundingNetwork | None,
    folder: RunFolder,
    resume: bool,
    should_stop: Callable[[], bool],
    until_step: int | None,
    check_lock: Callable[[], None],
) -> Run:
    """Train in a run folder that no other process writes to; see `train`."""
    last = config.total_steps
    knowledge = parts.knowledge
    continued = resume and folder.has_checkpoint
    if resume:
        folder.write_experiment(config)
    if continued:
        knowledge = replace(knowledge, table=folder.knowledge())
        parts = replace(parts, knowledge=knowledge)
    policy = parts.new_policy(config.seed)

    def should_end() -> bool:
        if until_step is not None and until_step <= trainer.step < last:
            return True
        return should_stop() or folder.ended_early_at(config.stop_when) is not None

    with TrainingProgress(f"{config.name}/{config.seed}", last) as progress:
        lines = announcements(parts, policy)
        if config.solves:
            lines[0] = "no policy: inverse kinematics act on what the network sees"
        for line in lines:
            progress.line(line)
        grounding = config.knows.grounding
        embedding = knowledge.embedding
        if grounding is not None and embedding is not None and network is None:
            folder.write_experiment(config)  # can resume
            network = train_grounding(
                config.env,
                knowledge.table,
                embedding.slots_per_row,
                grounding,
                seed=config.seed,
                report=progress.line,
                should_stop=should_stop,
            )
            if network is None:
                stopped = TrainingResult(
                    step=0, reason="stopped", best_return=None, best_step=None
                )
                return Run(folder, stopped)
        if network is not None:
            knowledge = config.knows.known(
                config.env, config.seed, table=knowledge.table, network=network
            )
        logs = RunLogs(folder, progress)
        trainer = make_trainer(
            config,
            policy,
            knowledge,
            evaluate_every=config.evaluate_every,
            hooks=Hooks(
                on_metrics=logs.metrics,
                on_evaluation=logs.evaluation,
                should_stop=should_end,
            ),
            checkpoints=CheckpointStore(
                folder.checkpoints, description(config, policy), check_lock
            ),
            checkpoint_every=config.checkpoint_every_steps,
            failure_folder=folder.path / "failure",
        )
        keep_to_step = None
        if continued:
            trainer.resume()
            progress.line(f"resuming at step {trainer.step:,}")
            changes = folder.note_resumption(trainer.step, to_dict(config.algorithm))
            if changes:
                progress.line(f"provenance.json records what has changed: {changes}")
            keep_to_step = trainer.step
            goes_on = trainer.step < last or trainer.lacks_evaluation
            if goes_on and not should_end():
                folder.set_evaluations_aside(trainer.step)
        else:
            # Written after the trainer is built: a config that this machine cannot train leaves
            # no run behind.
            _describe(folder, config, parts, policy, network)
            if resume:
                progress.line("no checkpoint yet: starting from the beginning")
                keep_to_step = BEFORE_FIRST_STEP
        logs.open(keep_to_step=keep_to_step, pending=trainer.pending_evaluations.keys())
        try:
            result = trainer.train(last)
        finally:
            logs.close()
        step = folder.ended_early_at(config.stop_when)
        if step is not None:
            progress.line(f"learned, as stop_when defines it, at step {step:,}")
            result = replace(result, reason="finished")
    return Run(folder, result)


def build(config: ExperimentConfig) -> Parts:
    """Compute the knowledge table of an experiment and the shape of its policy; nothing simulates.

    The table has a row per query in a task with queries, else per facet.
    """
    env = config.env
    knowledge = config.knows.known(env, config.seed)
    if env.task.skill.tells_facts and not knowledge.is_grounded:
        raise UserError(
            f"The agent {config.agent!r} is not told where to put an object, which a graph and an "
            "image decide in this task. Take an agent with a grounding network, such as 'answers'."
        )
    policy = _policy_config(config.policy, knowledge)
    shape = PolicyShape(
        joints=len(env.task.skill.joint_names(robot_of(env))),
        levels=len(ACTION_LEVELS),
        image_size=env.image_size,
        knowledge_dim=knowledge.width,
        knowledge_slots=knowledge.slots,
    )
    if policy.wide or policy.fusion == "none":
        knowledge = knowledge.unread()
    return Parts(knowledge, policy, shape)


def _policy_config(config: PolicyConfig, knowledge: Knowledge) -> PolicyConfig:
    """Return the choices of a policy with some knowledge.

    It trains vectors whose source gives them no meaning.
    """
    if knowledge.embedding is None:
        return replace(config, fusion="none")
    encoder = knowledge.embedding.config.source.encoder
    if encoder == "identity":
        return config
    return replace(config, knowledge_encoder=encoder)


def make_trainer(
    config: ExperimentConfig,
    policy: Policy,
    knowledge: Knowledge,
    **options: Any,
) -> Trainer:
    """Make the trainer of an experiment; ``options`` are those of `knowarm.learn.Trainer`."""
    return algorithms()[config.algorithm.name].make_trainer(
        config.algorithm,
        policy,
        seed=config.seed,
        make_env=partial(knowledge.make_env, config.env),
        make_evaluate=partial(
            interim_evaluation,
            config.env,
            config.interim,
            partial(knowledge.make_player, config.env, greedy=True),
        ),
        **options,
    )


def announcements(parts: Parts, policy: Policy) -> list[str]:
    """Describe the policy network and its knowledge vector in a few lines for the terminal."""
    counts = policy.parameter_counts()
    total = counts.pop("total")
    groups = ", ".join(f"{name} {count:,}" for name, count in counts.items() if count)
    lines = [f"{total:,} parameters ({groups})"]
    embedding = parts.knowledge.embedding
    numbers = parts.knowledge.table.shape[1]
    if embedding is None or numbers == 0:
        return [*lines, "no knowledge vector"]
    lines.append(f"knowledge: {numbers} numbers, norm {embedding.norm:.3f}")
    if embedding.constant:
        lines.append(
            "the knowledge vector is the same in every episode: a constant input, which the "
            "network can only use as a bias; compare with the controls (knowarm list)"
        )
    if embedding.privileged:
        lines.append(
            "the knowledge identifies the episode's target: privileged information"
        )
    if embedding.note:
        lines.append(embedding.note)
    return lines


def description(config: ExperimentConfig, policy: Policy) -> dict[str, Any]:
    """Describe what a checkpoint belongs to, as flat values; others are refused on resuming."""
    choices = to_dict(policy.resolved_config)
    del choices["wide"]
    # Of the initial weights only; checkpoints of before do not name it.
    del choices["actor_gain"]
    return {
        "robot": config.env.robot,
        "agent": config.agent,
        "algorithm": config.algorithm.name,
        "seed": config.seed,
        **flatten(choices, "policy.config."),
        **flatten(to_dict(policy.shape), "policy.shape."),
    }


def _describe(
    folder: RunFolder,
    config: ExperimentConfig,
    parts: Parts,
    policy: Policy,
    network: GroundingNetwork | None,
) -> None:
    """Write provenance, knowledge table, grounding network and config before the first step."""
    embedding = parts.knowledge.embedding
    perception = None
    if network is not None:
        perception = {"digest": digest(network.to_bytes()), **to_dict(network.spec)}
        network.write(folder.path / PERCEPTION_FILE)
    about = provenance(
        parameter_counts=policy.parameter_counts(),
        policy={
            "config": to_dict(policy.resolved_config),
            "shape": to_dict(policy.shape),
        },
        facets=facets_of(config.env),
        knowledge=embedding and embedding.describe(),
        perception=perception,
        algorithm=to_dict(config.algorithm),
    )
    write_json(folder.provenance_path, to_dict(about))
    folder.write_knowledge(parts.knowledge.table)
    folder.write_experiment(config)


def other_fields(run: RunFolder, config: ExperimentConfig) -> dict[str, str]:
    """Return the fields in which a run and a config differ, each with "field: value | value"."""
    kept = with_inputs(to_dict(config), run.copy_of)
    different = {}
    for name, (stored, now) in differences(to_dict(run.experiment()), kept).items():
        different[name] = f"{name}: {stored!r} | {now!r}"
        if str(run.path) in str(stored):
            hint = "(a copy: restore the original from it, which has changed since)"
            different[name] = f"{name}: {stored!r} {hint} | {now!r}"
    return different
