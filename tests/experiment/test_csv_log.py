"""Logs of a training."""

from knowarm.experiment.csv_log import training_seconds


def test_the_clock_restarts_at_every_resume():
    assert training_seconds([1.0, 2.5, 4.0]) == 4.0
    assert training_seconds([1.0, 2.5, 0.5, 3.0, 1.0]) == 2.5 + 3.0 + 1.0
    assert training_seconds([]) == 0.0
