import logging
import math
import pickle

import pytest
import torch
from safetensors.torch import load_file

from knowarm.learn.guards import FiniteGuard, HealthMonitor, NotFiniteError


def test_the_non_finite_term_is_named_and_the_batch_saved(tmp_path):
    guard = FiniteGuard(tmp_path / "failures")
    batch = {"reward": torch.arange(6.0).view(2, 3).t()}
    terms = {
        "the value loss": torch.tensor(1.0),
        "the entropy": torch.tensor([0.0, math.inf]),
    }
    with pytest.raises(
        NotFiniteError, match="step 40: the entropy is not finite"
    ) as caught:
        guard.check(terms, 40, batch)
    file = tmp_path / "failures" / "not-finite-40.safetensors"
    assert str(file) in str(caught.value)
    assert torch.equal(load_file(file)["reward"], batch["reward"])
    copy = pickle.loads(pickle.dumps(caught.value))
    assert (type(copy), str(copy)) == (NotFiniteError, str(caught.value))


def test_finite_terms_pass_and_nothing_is_written(tmp_path):
    FiniteGuard(tmp_path / "failures").check({"x": torch.ones(3)}, 1, {})
    assert not (tmp_path / "failures").exists()


def test_a_collapsed_entropy_is_warned_of_once(caplog):
    monitor = HealthMonitor(joints=6, levels=7, gamma=0.99)
    values, rewards = torch.zeros(3), torch.ones(3)
    with caplog.at_level(logging.WARNING, "knowarm.learn"):
        monitor.watch(step=1, entropy=6.0, values=values, rewards=rewards)
        assert not caplog.records
        monitor.watch(step=2, entropy=0.1, values=values, rewards=rewards)
        monitor.watch(step=3, entropy=0.1, values=values, rewards=rewards)
    assert [r.getMessage()[:18] for r in caplog.records] == ["Step 2: the entrop"]


def test_a_value_beyond_every_possible_return_is_warned_of(caplog):
    monitor = HealthMonitor(joints=1, levels=2, gamma=0.9)
    rewards = torch.tensor([-3.0, 1.0])  # no return exceeds 3 / (1 - .9) = 30
    with caplog.at_level(logging.WARNING, "knowarm.learn"):
        monitor.watch(
            step=1, entropy=0.6, values=torch.tensor([299.0]), rewards=rewards
        )
        assert not caplog.records
        monitor.watch(
            step=2, entropy=0.6, values=torch.tensor([-301.0]), rewards=rewards
        )
    assert "the critic diverges" in caplog.text


def test_values_before_the_first_reward_are_no_reason_to_warn(caplog):
    monitor = HealthMonitor(joints=1, levels=2, gamma=0.9)
    with caplog.at_level(logging.WARNING, "knowarm.learn"):
        monitor.watch(
            step=1, entropy=0.6, values=torch.tensor([0.5]), rewards=torch.zeros(3)
        )
    assert not caplog.records
