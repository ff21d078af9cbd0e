"""Precision of products, timing and CUDA graphs."""

import pytest
import torch

from knowarm.errors import UserError
from knowarm.learn import PPOConfig
from knowarm.learn.device import CudaGraph, Stopwatch, resolve_precision
from tests.devices import DEVICES
from tests.tape import Tape


@pytest.mark.cuda
@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_a_cuda_graph_takes_new_arguments_and_shapes():
    graph = CudaGraph(lambda x: x * 2 + 1)
    for size in (3, 3, 5):
        x = torch.randn(size, device="cuda")
        torch.testing.assert_close(graph(x), x * 2 + 1)


def test_a_recorded_function_takes_new_arguments_and_shapes():
    graph = CudaGraph(lambda x, y: (x * y, x + 1), Tape().capture)
    for size in (3, 3, 5):
        x, y = torch.randn(size), torch.randn(size)
        product, more = graph(x, y)
        torch.testing.assert_close((product, more), (x * y, x + 1))
        assert graph(x + 1, y)[1] is more, "results keep their memory"


@pytest.mark.parametrize("device", DEVICES)
def test_a_stopwatch_adds_intervals_and_nothing_between(device):
    watch, x = Stopwatch(torch.device(device)), torch.ones(512, 512, device=device)
    assert watch.seconds() == 0
    watch.start()
    y = x @ x
    watch.stop()
    once = watch.seconds()
    for _ in range(20):
        y = y @ x
    assert watch.seconds() == once > 0
    watch.start()
    y = y @ x
    watch.stop()
    assert watch.seconds() > once


def test_precisions_and_processes_of_the_other_device_are_rejected():
    with pytest.raises(UserError, match="'tf32' exists on GPUs only"):
        resolve_precision("tf32", torch.device("cpu"))
    with pytest.raises(UserError, match="processes"):
        PPOConfig(device="cuda", processes=2)


def test_auto_follows_the_hardware(monkeypatch):
    for fast, expected in ((True, "bfloat16"), (False, "float32")):
        monkeypatch.setattr("knowarm.learn.device.cpu_has_bfloat16", lambda answer=fast: answer)
        assert resolve_precision("auto", torch.device("cpu")) == expected
        assert resolve_precision("float32", torch.device("cpu")) == "float32"
