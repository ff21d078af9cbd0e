import signal
import sys

import pytest

from knowarm.experiment.logs import TrainingProgress
from knowarm.experiment.run_lock import StopRequest

NAMES = [name for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
hangup = pytest.mark.skipif(
    not hasattr(signal, "SIGHUP"), reason="Windows has no SIGHUP"
)


@pytest.fixture(autouse=True)
def default_hangup():
    """Handle SIGHUP as by default: under nohup it is ignored."""
    if not hasattr(signal, "SIGHUP"):
        yield
        return
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize("name", NAMES)
def test_a_signal_asks_to_stop(name):
    """A job's end signals every process, and the driver of a study its workers once more."""
    before = signal.getsignal(getattr(signal, name))
    with StopRequest() as should_stop:
        assert not should_stop()
        for _ in range(1 if name == "SIGINT" else 2):
            signal.raise_signal(getattr(signal, name))
            assert should_stop()
    assert signal.getsignal(getattr(signal, name)) is before


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_the_second_ctrl_c_interrupts(name):
    with StopRequest():
        signal.raise_signal(getattr(signal, name))
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)


@hangup
def test_nohup_is_respected():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with StopRequest() as should_stop:
            signal.raise_signal(signal.SIGHUP)
            assert not should_stop()
    finally:
        signal.signal(signal.SIGHUP, before)


def test_lines_for_a_terminal_that_has_closed_are_dropped(monkeypatch):
    class Closed:
        def write(self, text):
            raise OSError(5, "Input/output error")

        def flush(self):
            raise OSError(5, "Input/output error")

    with TrainingProgress("run", 10) as progress:
        monkeypatch.setattr(sys, "stderr", Closed())
        progress.line("text")
        progress.evaluation(5, {"return_mean": 1.0, "success": 0.5}, True)
