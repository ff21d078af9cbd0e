"""Precision of products, and the options of a device."""

import pytest
import torch

from knowarm.errors import UserError
from knowarm.learn import PPOConfig
from knowarm.learn.optimizer import resolve_precision


def test_processes_are_rejected_on_a_gpu():
    with pytest.raises(UserError, match="processes"):
        PPOConfig(device="cuda", processes=2)


def test_auto_follows_the_hardware(monkeypatch):
    for fast, expected in ((True, "bfloat16"), (False, "float32")):
        monkeypatch.setattr(
            "knowarm.learn.optimizer.cpu_has_bfloat16", lambda answer=fast: answer
        )
        assert resolve_precision("auto", torch.device("cpu")) == expected
        assert resolve_precision("float32", torch.device("cpu")) == "float32"
