"""The shipped policies still do on a fresh clone what they did when they were trained."""

import dataclasses
from pathlib import Path

import pytest

from knowarm.experiment.config import EvaluationConfig
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.load import load_agent

ZOO = Path(__file__).parents[2] / "zoo"
AGENTS = sorted(path.name for path in ZOO.iterdir() if path.is_dir())
JUDGED = EvaluationConfig(
    episodes=100, num_envs=50, record_steps=False, record_films=0, blind_episodes=0
)


@pytest.mark.parametrize("name", AGENTS)
def test_a_shipped_policy_reaches_its_targets(name):
    trained = load_agent(ZOO / name)
    assert trained.config.name == name
    summary = evaluate(trained, config=JUDGED, write=False).summary
    if trained.config.env.task.kind == "choose":
        assert summary["choice"] >= 0.9
        assert summary["success"] >= 0.8
    else:
        assert summary["success"] >= 0.9
        assert min(target["success"] for target in summary["per_target"].values()) >= 0.8


@pytest.mark.parametrize("name", AGENTS)
def test_a_shipped_policy_is_small(name):
    assert sum(file.stat().st_size for file in (ZOO / name).rglob("*") if file.is_file()) < 8e6


@pytest.mark.parametrize("name", AGENTS)
def test_the_knowledge_it_was_trained_with_is_what_the_package_builds(name):
    from knowarm.experiment.build import build

    trained = load_agent(ZOO / name)
    parts = build(dataclasses.replace(trained.config))
    assert parts.table.tobytes() == trained.folder.knowledge().tobytes()
