import pytest

from knowarm.study import driver
from knowarm.study.driver import run_study
from tests.study.tiny import InlineExecutor, tiny


@pytest.fixture
def inline(monkeypatch):
    monkeypatch.setattr(driver, "make_executor", InlineExecutor)


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """The folder of a complete study; copy it before changing anything."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(driver, "make_executor", InlineExecutor)
        patch.setattr(driver, "POLL_S", 0.0)
        patch.setattr(driver, "STATUS_S", 0.0)
        out = tmp_path_factory.mktemp("studies") / "tiny"
        run_study(tiny(), out)
    return out
