import pytest

import knowarm.study.estimate
from knowarm.errors import UserError
from knowarm.experiment.config import EvaluationConfig
from knowarm.study.estimate import estimate
from knowarm.study.executors import Local
from tests.study.tiny import OVERRIDES, tiny


def test_the_cost_of_a_study_is_measured_and_nothing_is_written(tmp_path):
    study = tiny(where=Local(at_once=1))
    found = estimate(study, tmp_path / "out")
    (row,) = found.rows
    assert (row.experiment, row.runs, found.slots) == ("irb120-bm-ppo", 2, 1)
    # At least two trainings of 80 steps.
    assert found.core_hours == row.core_hours > 2 * 80 / row.steps_per_s / 3600 > 0
    assert found.hours == found.core_hours
    assert not (tmp_path / "out").exists()


def test_what_blind_agents_play_and_their_search_cost_too(tmp_path, monkeypatch):
    asked = []

    def measure(config, cores, *, search):
        asked.append(search)
        return {"steps_per_s": 1e9, "episodes_per_s": 1.0, "search_s": 100.0, "start_s": 0.0}

    monkeypatch.setattr(knowarm.study.estimate, "measure", measure)
    evaluations = (
        EvaluationConfig(episodes=10, blind_episodes=0),
        EvaluationConfig(label="b", episodes=10, blind_episodes=20),
    )
    hours = []
    for some in (evaluations[:1], evaluations):
        found = estimate(tiny(evaluations=some, where=Local(at_once=1)), tmp_path / "out")
        hours.append(found.core_hours * 3600)
    assert asked == [False, True]
    # Two runs; open-loop, blind and frozen agent play the ten episodes, too.
    assert hours == pytest.approx([2 * 10, 2 * (10 + 4 * 10) + 100], abs=1e-3)


def test_an_experiment_that_cannot_be_trained_is_named(tmp_path):
    algorithm = {**OVERRIDES["algorithm"], "device": "cuda", "processes": None}
    study = tiny(overrides={**OVERRIDES, "algorithm": algorithm}, where=Local(at_once=1))
    with pytest.raises(UserError, match=r"irb120-bm-ppo cannot be trained: .*cuda"):
        estimate(study, tmp_path)
