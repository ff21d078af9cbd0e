"""Probes of every evaluation: steps, films, blind agents; and what all probes are given."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from knowarm.arrays import Floats, Mask
from knowarm.experiment.minimal_pairs import PairsProbe, other_questions, told_questions
from knowarm.knowledge import KnowledgeGraph
from knowarm.questions import Query
from knowarm.statistics import bootstrap, share_difference, share_of
from knowarm.world.agents import BLIND_AGENTS, AgentProtocol
from knowarm.world.agents.play import EpisodeResults, play
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks import task_probes
from knowarm.world.tasks.probe import BaseProbe, Findings
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
    report: Callable[[str], None]
    """Receives lines on the progress."""
    know: Callable[[KnowledgeGraph, Query], Any] | None = None
    """Returns the row, (D,), of a query that the agent has if it knows a graph; None for an agent
    that was not trained."""

    @property
    def scene(self) -> Scene:
        """Robot and objects."""
        return self.env.scene

    @property
    def success(self) -> Mask:
        """Which episodes were solved, (n,)."""
        return self.result.success

    def paths(self, rows: NDArray[np.intp]) -> list[Floats]:
        """Return the joint angles of some episodes by step, (T, J) [rad] each."""
        steps = self.result.steps
        first = np.searchsorted(steps.episode, np.arange(1, len(self.episodes)))
        paths = np.split(steps.joint_positions, first)
        return [paths[i] for i in rows]


@dataclass(frozen=True, kw_only=True)
class StepsProbe(BaseProbe):
    """Keep joint angles, action, distance and angle of every step."""

    kind: Literal["steps"] = "steps"

    def measure(self, played: Played, findings: Findings) -> None:
        """Add the columns of ``steps.parquet``."""
        steps = played.result.steps
        columns = {
            "episode": steps.episode,
            "step": steps.step,
            "distance_m": steps.distance,
            "angle_deg": steps.angle,
            "reward": steps.reward,
        }
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

    def measure(self, played: Played, findings: Findings) -> None:
        """Add the group ``blind`` and the numbers ``vision_gain`` and ``binding``.

        By name of a blind agent its ``episodes``, ``success`` and ``difference``, the success of
        the agent over all episodes minus its own; ``vision_gain`` is the smallest difference to an
        agent that sees nothing. ``binding`` says whether an agent follows its question: given the
        question of another visible object in each episode, its share of right choices falls by
        this much.
        """
        if not played.is_trained:
            return
        share = share_of(played.success)
        first = played.episodes[: self.episodes]
        numbers: dict[str, dict[str, Any]] = {}
        gains = []
        for name, entry in BLIND_AGENTS.items():
            blind = entry.make(played.agent, played.env, played.seed)
            played.report(f"Blind agent {name}: {len(first):,} episodes.")
            blind_share = share_of(play(blind, played.env, first).success)
            difference = share_difference(share, blind_share)
            numbers[name] = {
                "episodes": float(len(first)),
                "success": blind_share,
                "difference": difference,
            }
            if entry.sees_nothing:
                gains.append(difference)
        findings.groups["blind"] = numbers
        findings.numbers["vision_gain"] = min(gains, key=lambda gain: gain.estimate)
        is_told = getattr(played.agent, "depends_on_rows", False)
        if is_told and "is_right_object" in played.result.infos:
            self._measure_binding(played, first, findings)

    def _measure_binding(
        self,
        played: Played,
        episodes: Episodes,
        findings: Findings,
    ) -> None:
        """Play the episodes with the questions of other visible objects."""
        questions, _ = other_questions(played.env, episodes, played.seed)
        asked = np.flatnonzero(questions)
        if len(asked):
            agent = told_questions(played.agent, played.env, questions[asked])
            result = play(agent, played.env, episodes[asked])
            right = played.result.infos["is_right_object"][asked].astype(float)
            loss = right - result.infos["is_right_object"]
            findings.numbers["binding"] = bootstrap(loss, repetitions=2_000)


def probe_types() -> list[type[BaseProbe]]:
    """List the probes: those of every evaluation, and those that parts of tasks bring."""
    return [StepsProbe, FilmsProbe, BlindProbe, *optional_probes()]


def optional_probes() -> list[type[BaseProbe]]:
    """List the probes without options that an evaluation has only on request."""
    return [PairsProbe, *task_probes()]
