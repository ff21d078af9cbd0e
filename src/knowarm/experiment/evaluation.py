"""Configuration of an evaluation: its episodes, the conditions of the test, and probes."""

from dataclasses import dataclass, field, replace
from typing import Literal

from knowarm.config import above_zero, at_least, check_values, file_name, registered
from knowarm.errors import UserError
from knowarm.experiment.conditions import AnyCondition, GraphTest, SplitTest, Subject
from knowarm.experiment.probes import BlindProbe, FilmsProbe, StepsProbe, probe_types
from knowarm.knowledge.queries.splits import Split
from knowarm.world.config import EnvConfig
from knowarm.world.tasks.probe import BaseProbe


@dataclass(frozen=True, kw_only=True)
class EvaluationConfig:
    """Settings of a post-training evaluation (paper section 4.2.4)."""

    episodes: int = 1000
    """Total number of episodes."""
    seed: int = 1_000_003
    """Seed of the fixed episodes; far from training seeds, so that none was trained on."""
    seeds: int = 1
    """Number of seeds that the episodes are drawn from in equal shares: ``seed``, ``seed`` + 1,
    and so on; the paper's analysis of variance takes 30 seeds of 100 episodes."""
    distance_m: float = 0.10
    """Largest distance of a success [m]."""
    angle_deg: float = 17.0
    """Largest angle of a success [deg]; the paper's section 4. Its section 3 says 20."""
    actions: Literal["greedy", "sampled"] = "greedy"
    """Take the most probable action, or sample one."""
    test: tuple[AnyCondition, ...] = ()
    """Conditions that differ from training, in the order in which they apply."""
    probes: tuple[BaseProbe, ...] = field(
        default=(StepsProbe(), FilmsProbe(), BlindProbe()), metadata=registered(probe_types)
    )
    """What is recorded and measured besides the outcome of the episodes."""
    label: str | None = None
    """Name of the folder of the evaluation's files; None takes ``post-training-<actions>`` and the
    labels of ``test`` and ``probes``."""

    def __post_init__(self) -> None:
        check_values(self)
        at_least(self, 1, "episodes", "seeds")
        above_zero(self, "distance_m", "angle_deg")
        file_name(self, "label")
        if self.split not in (None, "S1") and any(isinstance(t, GraphTest) for t in self.test):
            raise UserError(
                "With another graph everything that it can be asked is a question of S1, got "
                f"split={self.split!r}. Leave split out."
            )
        if self.episodes % self.seeds:
            raise UserError(
                f"{self.episodes} episodes cannot be shared equally by {self.seeds} seeds; give a "
                f"multiple of {self.seeds}."
            )

    @property
    def folder(self) -> str:
        """Name of the folder of the evaluation's files."""
        parts = [f"post-training-{self.actions}", *(each.label for each in self.test)]
        return self.label or "-".join([*parts, *(p.label for p in self.probes if p.label)])

    @property
    def split(self) -> Split | None:
        """The split that is asked, or None for the questions of training."""
        return next((each.split for each in self.test if isinstance(each, SplitTest)), None)

    @property
    def films(self) -> int:
        """Number of episodes, from the first, whose images are kept."""
        return max(
            (each.episodes for each in self.probes if isinstance(each, FilmsProbe)), default=0
        )

    def prepare(self, subject: Subject) -> Subject:
        """Return a subject under the conditions and thresholds of the evaluation."""
        for condition in self.test:
            if condition.changes_agent and subject.config is None:
                raise UserError(
                    f"Only trained agents can be evaluated with {condition.kind}. Leave it out, or "
                    "pass a run folder."
                )
            subject = condition.prepare(subject)
        judged = replace(
            subject.env, success_distance_m=self.distance_m, success_angle_deg=self.angle_deg
        )
        return replace(subject, env=judged)

    def stored(self, env: EnvConfig) -> EnvConfig:
        """Return the environment that was played as the summary stores it."""
        for condition in self.test:
            env = condition.stored(env)
        return env
