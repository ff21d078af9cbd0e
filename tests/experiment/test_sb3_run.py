"""Runs of Stable-Baselines3 stand beside KnowArm's in report and figure."""

from dataclasses import replace

import pytest

import knowarm
from knowarm.errors import UserError
from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.report.collect import collect
from knowarm.report.figure import write_figure
from knowarm.report.pages.training import curve_lines
from tests.tiny import short

sb3 = pytest.importorskip("stable_baselines3")


def trained(config, runs, **shown):
    env = knowarm.ArmVectorEnv(config.env, 4, **shown)
    model = sb3.PPO(
        "MultiInputPolicy" if "observe" in shown else "CnnPolicy",
        knowarm.SB3VecEnv(env, seed=0),
        n_steps=8,
        batch_size=16,
        n_epochs=1,
    )
    evaluation = EvaluationConfig(episodes=4, probes=())
    model.learn(64, callback=knowarm.SB3Run(config, runs, evaluation))
    return runs / f"{config.name}-sb3" / str(config.seed)


def test_a_run_stands_beside_those_of_the_library(reach_run, tmp_path):
    config = reach_run.folder.experiment()
    table = reach_run.folder.knowledge()
    path = trained(config, tmp_path, observe=("image", "knowledge"), knowledge=table)
    (task,) = collect([reach_run.folder.path, path]).tasks
    own, other = task.groups
    assert (own.agent, other.agent) == (config.agent, "SB3 PPO")
    assert own.colour != other.colour
    (run,) = other.runs
    assert run.interim["step"].tolist() == [*range(0, 65, 8)]
    assert {"return_mean", "success"} <= set(run.interim)
    assert other.evaluations[0].summary["episodes"] == 4
    names = [line.name for line in curve_lines(task, ["success"])["success"]]
    assert names == [own.name, "SB3 PPO"]
    out = tmp_path / "table.md"
    write_figure([reach_run.folder.path, path], out)
    assert "| SB3 PPO |" in out.read_text()


def test_what_it_cannot_evaluate_is_refused_before_training(tmp_path):
    config = replace(short(), name="joints")
    with pytest.raises(UserError, match=r"also observes joints\. Leave that out"):
        trained(config, tmp_path, observe=("image", "joints"))
    assert not (tmp_path / "joints-sb3").exists()
