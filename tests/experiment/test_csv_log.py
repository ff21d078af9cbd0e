"""Logs of a training."""

from knowarm.experiment.csv_log import training_clock, training_seconds


def test_the_clock_restarts_at_every_resume():
    assert training_seconds([1.0, 2.5, 4.0]) == 4.0
    assert training_seconds([1.0, 2.5, 0.5, 3.0, 1.0]) == 2.5 + 3.0 + 1.0
    assert training_seconds([]) == 0.0


def test_the_time_at_every_row_counts_what_was_before_a_resume():
    clock = training_clock([1.0, 2.5, 0.5, 3.0])
    assert clock.tolist() == [1.0, 2.5, 3.0, 5.5]
