import pytest

from knowarm.study import driver
from knowarm.study.driver import run_study
from knowarm.study.executors import EXECUTORS, ExecutorEntry
from tests.study.tiny import Inline, InlineExecutor, tiny

INLINE = ExecutorEntry(about="in this process", default=Inline(), make=InlineExecutor)


@pytest.fixture
def inline(monkeypatch):
    monkeypatch.setitem(EXECUTORS, "inline", INLINE)


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of a complete study; not to be changed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(EXECUTORS, "inline", INLINE)
        patch.setattr(driver, "POLL_S", 0.0)
        patch.setattr(driver, "STATUS_S", 0.0)
        out = tmp_path_factory.mktemp("studies") / "tiny"
        run_study(tiny(), out)
    return out
