"""Probes of an evaluation: what is recorded or measured of the episodes besides their outcome."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any, ClassVar, Literal

import numpy as np

from knowarm.config import at_least
from knowarm.errors import UserError
from knowarm.experiment.measures import EXCLUDED, NOT_REACHED, Number, Numbers
from knowarm.statistics import bootstrap, share_difference, wilson
from knowarm.world.agents import BLIND_AGENTS, AgentProtocol, Batch
from knowarm.world.agents.play import EpisodeResults, play
from knowarm.world.agents.scripted import InformedAgent
from knowarm.world.config import questions_of
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.lift.probe import build_trial_scene, lift
from knowarm.world.tasks.sampling import Episodes


@dataclass(frozen=True)
class Played:
    """An agent, the episodes that it played, and their outcome."""

    agent: AgentProtocol
    env: ArmVectorEnv
    episodes: Episodes
    result: EpisodeResults
    seed: int
    is_trained: bool
    """Whether it is a trained agent, and not that of its initial weights."""
    report: Callable[[str], None] = lambda line: None
    """Receives lines on the progress."""


@dataclass
class Findings:
    """What probes found: columns of episodes and steps, numbers, and groups of numbers."""

    columns: dict[str, np.ndarray]
    steps: dict[str, np.ndarray] | None = None
    numbers: dict[str, Number] = field(default_factory=dict)
    groups: dict[str, Mapping[str, Numbers]] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class BaseProbe:
    """Something recorded or measured of the episodes."""

    label: ClassVar[str] = ""
    """Its part of the name of the evaluation's folder."""
    kind: str = ""

    def check(self, env: ArmVectorEnv) -> None:
        """Refuse, before anything is played, an environment that it cannot measure in."""

    def measure(self, played: Played, findings: Findings) -> None:
        """Add what it measures to what was found."""


@dataclass(frozen=True, kw_only=True)
class StepsProbe(BaseProbe):
    """Keep joint angles, action, distance and angle of every step."""

    kind: Literal["steps"] = "steps"

    def measure(self, played: Played, findings: Findings) -> None:
        """Add the columns of ``steps.parquet``."""
        from knowarm.experiment.evaluation_files import STEP_COLUMNS

        steps = played.result.steps
        values = (steps.episode, steps.step, steps.distance, steps.angle, steps.reward)
        columns = dict(zip(STEP_COLUMNS, values, strict=True))
        for i in range(steps.joint_positions.shape[1]):
            columns[f"joint_{i + 1}_rad"] = steps.joint_positions[:, i]
            columns[f"action_{i + 1}"] = steps.actions[:, i]
        findings.steps = columns


@dataclass(frozen=True, kw_only=True)
class FilmsProbe(BaseProbe):
    """Keep the images of some episodes."""

    kind: Literal["films"] = "films"
    episodes: int = 6
    """Number of episodes, from the first."""


@dataclass(frozen=True, kw_only=True)
class BlindProbe(BaseProbe):
    """Let controls play the episodes of a trained agent: blind agents, and itself misinformed."""

    kind: Literal["blind"] = "blind"
    episodes: int = 200
    """Number of episodes, from the first."""

    def __post_init__(self) -> None:
        at_least(self, 1, "episodes", where="blind.")

    def measure(self, played: Played, findings: Findings) -> None:
        """Add the group ``blind`` and the numbers ``vision_gain`` and ``binding``.

        By name of a blind agent its ``episodes``, ``success`` and ``difference``, the success of
        the agent over all episodes minus its own; ``vision_gain`` is the smallest difference to an
        agent that sees nothing. ``binding`` says whether an agent follows its question: it plays
        the episodes again, told a question whose answer is another visible object, and the share of
        right choices falls by this much.
        """
        if not played.is_trained:
            return
        success = played.result.success
        own = wilson(int(np.count_nonzero(success)), len(success))
        numbers: dict[str, dict[str, Any]] = {}
        for name, entry in BLIND_AGENTS.items():
            blind = entry.make(played.agent, played.env, played.seed)
            chosen = played.episodes[: self.episodes]
            played.report(f"Blind agent {name}: {len(chosen):,} episodes.")
            solved = play(blind, played.env, chosen).success
            share = wilson(int(np.count_nonzero(solved)), len(solved))
            numbers[name] = {"episodes": float(len(solved)), "success": share}
            numbers[name]["difference"] = share_difference(own, share)
        findings.groups["blind"] = numbers
        seeing = (numbers[n]["difference"] for n, e in BLIND_AGENTS.items() if e.sees_nothing)
        findings.numbers["vision_gain"] = min(seeing, key=lambda each: each.estimate)
        is_told = getattr(played.agent, "depends_on_rows", False)
        if is_told and "is_right_object" in played.result.infos:
            self._measure_binding(played, findings)

    def _measure_binding(self, played: Played, findings: Findings) -> None:
        """Play the episodes with the questions of other visible objects."""
        chosen = played.episodes[: self.episodes]
        questions = other_questions(played.env, chosen, played.seed)
        asked = np.flatnonzero(questions != "")
        told = iter(questions[asked])

        def misinform(batch: Batch) -> Batch:
            left = [str(each) for each in islice(told, batch.size)]
            filled = [*left, *batch.names[len(left) :]]  # the last batch repeats its last episode
            return replace(batch, names=np.array(filled))

        if len(asked):
            result = play(InformedAgent(played.agent, misinform), played.env, chosen[asked])
            right, misled = (r.infos["is_right_object"] for r in (played.result, result))
            gain = right[asked].astype(float) - misled
            findings.numbers["binding"] = bootstrap(gain, repetitions=2_000)


def other_questions(env: ArmVectorEnv, episodes: Episodes, seed: int) -> np.ndarray:
    """Draw a question that exactly one visible object answers, another than the right one, (n,).

    It is one that the task asks; empty where the visible objects allow none.
    """
    table = questions_of(env.config)
    assert table is not None
    shown = env.running.first_facet[episodes.objects] + episodes.colours
    answers = table.satisfies[:, shown]  # (Q, n, m)
    asked = np.asarray(table.askable.any(axis=1))
    fits = (answers.sum(2) == 1) & ~answers[..., 0] & asked[:, None]
    drawn = (np.random.default_rng(seed).random(fits.shape) * fits).argmax(0)
    names = np.array([query.name for query in table.queries])
    return np.where(fits.any(0), names[drawn], "")


@dataclass(frozen=True, kw_only=True)
class LiftProbe(BaseProbe):
    """Lift the object where an episode succeeds.

    Its joint path is replayed among solid objects, the fingers close, the arm lifts 10 cm and holds
    2 s.
    """

    label: ClassVar[str] = "lift"
    kind: Literal["lift"] = "lift"

    def check(self, env: ArmVectorEnv) -> None:
        """Refuse tasks whose actions move fingers, and robots without fingers."""
        robot = env.scene.robot
        if env.scene.joint_names != robot.joints:
            raise UserError(
                "A lift test lifts where episodes of a task end that moves the arm only; the task "
                f"{env.config.task.kind_of()!r} moves the fingers. Leave out the lift test."
            )
        build_trial_scene(robot, env.scene.targets[:1])

    def measure(self, played: Played, findings: Findings) -> None:
        """Lift the object of every successful episode; add ``lift`` and ``lift_rise_m``, (n,).

        Every episode ends at its first state within the thresholds, so each is lifted at most once.
        """
        scene, episodes, result = played.env.scene, played.episodes, played.result
        count = len(episodes)
        names = np.array([target.name for target in scene.targets])[episodes.target]
        excluded = np.isin(names, list(scene.robot.not_liftable))
        chosen = np.flatnonzero(result.success & ~excluded)
        outcome = np.where(excluded, EXCLUDED, NOT_REACHED).astype("U16")
        rise = np.zeros(count)
        if len(chosen):
            steps = result.steps
            first = np.searchsorted(steps.episode, np.arange(count + 1))
            paths = [steps.joint_positions[first[i] : first[i + 1]] for i in chosen]
            lifts = lift(scene, paths, episodes.objects[chosen], episodes.positions[chosen])
            outcome[chosen], rise[chosen] = lifts.outcome, lifts.rise
        findings.columns |= {"lift": outcome, "lift_rise_m": rise}


AnyProbe = StepsProbe | FilmsProbe | BlindProbe | LiftProbe
