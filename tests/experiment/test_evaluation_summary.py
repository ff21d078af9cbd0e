import numpy as np
import pytest

from knowarm.experiment.evaluation_summary import summarize
from knowarm.statistics import wilson


def episodes(success=(True, True, False, False), distance=(0.05, 0.08, 0.09, 0.5)):
    count = len(success)
    return {
        "target": np.array(["mug", "mug", "bottle", "bottle"][:count]),
        "facet": np.array(["mug/red", "mug/blue", "bottle/yellow", "bottle/yellow"][:count]),
        "return": np.array([90.0, 80.0, -10.0, -40.0][:count]),
        "length": np.array([5, 9, 50, 50][:count]),
        "distance_m": np.array(distance),
        "angle_deg": np.array([3.0, 5.0, 40.0, 80.0][:count]),
        "success": np.array(success),
        "accurate": np.array(distance) <= 0.1,
        "success_wide": np.array(success),
    }


def test_the_paper_s_numbers_by_hand():
    found = summarize(episodes())
    assert found["return_mean"] == 30
    assert found["return_std"] == pytest.approx(np.std([90, 80, -10, -40], ddof=1))
    assert found["length_mean"] == 28.5
    assert found["accuracy"] == 0.75  # the third ends near, at a wrong angle
    assert found["success"] == 0.5
    assert found["failures"] == 2
    assert found["failure_distance_mean"] == pytest.approx(0.295)
    assert found["failure_distance_std"] == pytest.approx(np.std([0.09, 0.5], ddof=1))
    assert found["failure_distance_max"] == 0.5


def test_shares_carry_wilson_s_interval():
    found, interval = summarize(episodes()), wilson(3, 4)
    assert (found["accuracy_low"], found["accuracy_high"]) == (interval.low, interval.high)
    assert found["return_mean_low"] < found["return_mean"] < found["return_mean_high"]


def test_parts_add_up_to_the_whole():
    found = summarize(episodes())
    assert set(found["per_target"]) == {"mug", "bottle"}
    assert set(found["per_facet"]) == {"mug/red", "mug/blue", "bottle/yellow"}
    assert sum(part["episodes"] for part in found["per_facet"].values()) == found["episodes"]
    assert found["per_target"]["mug"]["success"] == 1


def test_without_failures_there_is_no_failure_distance():
    found = summarize(episodes((True,), (0.01,)))
    assert found["failure_distance_mean"] is None
    assert found["failure_distance_max"] is None
    assert found["return_std"] == 0
