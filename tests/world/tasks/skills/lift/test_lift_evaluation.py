"""The lift test as a probe of evaluations: columns, numbers, and what is left out."""

import dataclasses

import numpy as np

from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.world.agents import ApproachAgent
from knowarm.world.agents.scripted import ZeroAgent
from knowarm.world.config import EnvConfig
from knowarm.world.robots import ROBOTS
from knowarm.world.scene.scene import _load_scene
from knowarm.world.tasks.skills.lift.probe import LiftProbe


def test_the_lift_test_counts_what_physics_holds():
    config = EvaluationConfig(
        episodes=6, distance_m=0.002, angle_deg=1.0, probes=(LiftProbe(),)
    )
    env = EnvConfig(targets=("mug", "bottle"), image_size=8, max_episode_steps=120)
    result = evaluate(ApproachAgent, env, config)
    outcomes = result.episodes["lift"]
    assert ((outcomes == "not reached") == ~result.episodes["success"]).all()
    assert ((outcomes == "lifted") == (result.episodes["lift_rise_m"] >= 0.08)).all()
    summary = result.summary
    lifted = np.count_nonzero(outcomes == "lifted")
    assert lifted >= 4
    assert summary["lifted"] == lifted / 6
    assert summary["grasps"] == lifted / np.count_nonzero(result.episodes["success"])
    assert summary.label == "post-training-greedy-lift"


def test_objects_that_cannot_be_lifted_are_left_out(monkeypatch):
    robot = dataclasses.replace(ROBOTS["irb120"], cannot_hold={"mug": "for this test"})
    monkeypatch.setitem(ROBOTS, "irb120", robot)
    _load_scene.cache_clear()
    config = EvaluationConfig(
        episodes=6, distance_m=2.0, angle_deg=180.0, probes=(LiftProbe(),)
    )
    env = EnvConfig(targets=("mug", "bottle"), image_size=8, max_episode_steps=1)
    summary = evaluate(ZeroAgent(), env, config).summary
    _load_scene.cache_clear()
    assert "lifted" not in summary.of("target", "mug")
    assert summary["lifted"] == 0
    assert summary["lift_missed"] == 1
