import pytest

from knowarm.errors import UserError
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


def test_an_experiment_that_cannot_be_trained_is_named(tmp_path):
    algorithm = {**OVERRIDES["algorithm"], "device": "cuda", "processes": None}
    study = tiny(overrides={**OVERRIDES, "algorithm": algorithm}, where=Local(at_once=1))
    with pytest.raises(UserError, match=r"irb120-bm-ppo cannot be trained: .*cuda"):
        estimate(study, tmp_path)
