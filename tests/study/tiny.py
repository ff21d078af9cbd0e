"""A study of tiny runs, and an executor that works in the calling process."""

from dataclasses import dataclass, field
from pathlib import Path

from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.experiment.probes import FilmsProbe, StepsProbe
from knowarm.study.config import StudyConfig
from knowarm.study.executor import Ended, Where
from knowarm.study.worker import work
from tests.tiny import STUDY

TOML = """
name = "tiny"
experiments = ["irb120-bm-ppo"]
seeds = [0, 1]
[overrides]
total_steps = 40
checkpoint_every_steps = 20
interim = {every_steps = 20, episodes = 2}
algorithm = {num_envs = 4, rollout_steps = 5, minibatches = 2, processes = 1}
env = {max_episode_steps = 25}
policy = {features = 16, hidden = 16}
[[evaluations]]
episodes = 2
probes = [{ kind = "steps" }, { kind = "films", episodes = 1 }]
"""


@dataclass
class InlineExecutor:
    """Works on one run at a time in this process; ``deaths`` are ends before any work."""

    where: Where
    out: Path
    slots: int = 1
    started: list = field(default_factory=list)
    deaths: int = 0
    _ended: list = field(default_factory=list)

    def start(self, run):
        self.started.append(run)
        if self.deaths:
            self.deaths -= 1
            self._ended.append(
                Ended(run, "its process was killed by signal 9", killed=True)
            )
            return
        work(self.out, run)
        self._ended.append(Ended(run))

    def ended(self):
        ended, self._ended = self._ended, []
        return ended

    def stop(self):
        pass

    def close(self):
        pass


def tiny(**changes) -> StudyConfig:
    values = {
        "name": "tiny",
        "experiments": ("irb120-bm-ppo",),
        "seeds": (0, 1),
        "overrides": STUDY,
        "evaluations": (
            EvaluationConfig(episodes=2, probes=(StepsProbe(), FilmsProbe(episodes=1))),
        ),
    }
    return StudyConfig(**{**values, **changes})
