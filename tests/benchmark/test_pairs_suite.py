"""Minimal pairs are played on the episodes of the frozen suite."""

import numpy as np

from knowarm.benchmark.suites import read_suite
from knowarm.experiment.evaluation import EvaluationConfig, SplitTest, Subject
from knowarm.study.config import read_study
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.tasks import find_task


def test_minimal_pairs_are_of_the_episodes_of_the_frozen_suite():
    (evaluation,) = read_study("minimal-pairs").evaluations
    cell = read_suite("choose-v1").cells["irb120-S1"]
    config = EvaluationConfig(
        test=(SplitTest(split="S1"),), distance_m=0.05, angle_deg=15.0
    )
    choose = EnvConfig(
        task=find_task("choose"), success_distance_m=0.05, success_angle_deg=15.0
    )
    env = config.prepare(Subject(env=choose)).env
    episodes = evaluation_episodes(env, 40, evaluation.seed)
    for name in ("objects", "colours", "positions", "question", "joint_offsets"):
        assert np.array_equal(
            getattr(cell.episodes, name)[:40], getattr(episodes, name)
        )
