"""Options and summary of the whole suite."""

import os
import random
import re
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

# Two test processes share two cores; more threads would wait for each other. Before torch is read.
os.environ.setdefault("OMP_NUM_THREADS", "1")

IS_WORKER = "PYTEST_XDIST_WORKER" in os.environ

REMEDIES = {
    "Chromium": ("apt-get install chromium", r"chromium"),
    "WordNet": ("apt-get install wordnet-base", r"wordnet"),
    "OpenGL": ("apt-get install libosmesa6 libgl1 libegl1", r"opengl|osmesa|egl"),
    "dm_control": ("pip install --no-deps dm_control", r"dm_control"),
}
"""What tests need beside the Python packages of the extra ``dev``: remedy, and pattern of the
reason with which they are skipped."""


@pytest.fixture(scope="session", autouse=IS_WORKER)
def compiled_kernels(tmp_path_factory):
    """Compile the kernels of images and rewards once: else each of the processes does, at once."""
    from filelock import FileLock

    from knowarm.world.config import EnvConfig
    from knowarm.world.envs.vector_env import ArmVectorEnv

    with FileLock(tmp_path_factory.getbasetemp().parent / "kernels.lock"):
        env = ArmVectorEnv(EnvConfig(), 1)
        env.reset(seed=0)
        env.step(env.action_space.sample())


@pytest.fixture(scope="session")
def exported_zoo(tmp_path_factory):
    """Export shipped policies: ``exported_zoo(name)`` is a folder; copy it before changing it.

    Those of the choose task by the function, the others by the command; each once, as it takes
    seconds, for all test processes.
    """
    from filelock import FileLock

    from knowarm.cli.main import main
    from knowarm.deploy.contract import export
    from knowarm.experiment.load import load_agent
    from tests.source_tree import ROOT

    place = tmp_path_factory.getbasetemp()
    if IS_WORKER:
        place = place.parent
    place /= "exported"
    place.mkdir(exist_ok=True)

    def exported(name):
        folder = place / name
        with FileLock(place / f"{name}.lock"):
            if not (folder / "contract.json").exists():  # which is written last
                run = ROOT / "zoo" / name
                if "-choose-" in name:
                    export(load_agent(run), folder)
                else:
                    assert main(["export", str(run), "--to", str(folder)]) == 0
        return folder

    return exported


@pytest.fixture(scope="session")
def reach_run(tmp_path_factory):
    """The run of ``short()``, trained once per test process; copy it before changing anything."""
    from knowarm.experiment.run import train
    from tests.tiny import short

    return train(short(), tmp_path_factory.mktemp("reach"))


@pytest.fixture(scope="module")
def unfenced():
    """Compute in this process what is fenced, as `without_forks` does."""
    from tests.thorough import without_forks

    with without_forks():
        yield


@pytest.fixture
def short_search(monkeypatch):
    """Let checks of robots try a tenth of the fixed lists of actions."""
    from knowarm.world.agents import OpenLoopAgent
    from knowarm.world.agents.open_loop import BUDGET, search_open_loop

    def searched_list(env, seed):
        return OpenLoopAgent(search_open_loop(env.config, BUDGET // 10, seed))

    monkeypatch.setattr("knowarm.own_robot.robot_check.searched_list", searched_list)


@pytest.fixture
def short_handshakes(monkeypatch):
    """Let servers give sockets two seconds for a handshake, not ten."""
    from knowarm.deploy import serve

    monkeypatch.setattr(serve, "serve", partial(serve.serve, open_timeout=2))


@pytest.fixture
def no_search(monkeypatch):
    """Let the fixed list of actions be one that stands still, in place of one that is searched."""
    import numpy as np

    from knowarm.world.envs.vector_env import ArmVectorEnv

    def stand_still(config, *, seed):
        joints = ArmVectorEnv(config, 1).single_action_space.shape
        return np.full((config.max_episode_steps, *joints), 3)

    monkeypatch.setattr("knowarm.world.agents.search_open_loop", stand_still)


@pytest.fixture(scope="session")
def choose_run(tmp_path_factory):
    """A run of the choose task, like `reach_run`."""
    from knowarm.experiment.run import train
    from tests.tiny import CHOOSE, CHOOSE_NAME

    return train(CHOOSE_NAME, tmp_path_factory.mktemp("choose"), **CHOOSE)


@pytest.fixture(scope="session")
def trained():
    """The shipped agent of the choose task."""
    from knowarm.experiment.load import load_agent
    from tests.source_tree import ROOT
    from tests.tiny import CHOOSE_NAME

    return load_agent(ROOT / "zoo" / CHOOSE_NAME)


@pytest.fixture
def copy_of(tmp_path):
    """Copies runs: ``copy_of(run)`` is the folder of a copy below ``tmp_path / "copy"``."""

    def copy(run):
        path = run.folder.path
        place = tmp_path / "copy" / path.parent.name / path.name
        return replace(run.folder, path=Path(shutil.copytree(path, place)))

    return copy


def pytest_addoption(parser):
    parser.addoption(
        "--order-seed",
        type=int,
        help="run modules, and the tests in them, in a random order",
    )


def seconds(item):
    """Return how long a test takes, as far as its mark says."""
    mark = item.get_closest_marker("slow")
    return mark.args[0] if mark and mark.args else 0


def pytest_collection_modifyitems(config, items):
    """Start the longest tests first: the last one to start would keep one process busy alone.

    With a seed, shuffle modules and tests instead; tests of a module stay together for the sake of
    its fixtures.
    """
    seed = config.getoption("--order-seed")
    if seed is None:
        items.sort(key=seconds, reverse=True)
        return
    modules = {}
    for item in items:
        modules.setdefault(item.module.__name__, []).append(item)
    generator = random.Random(seed)
    groups = list(modules.values())
    generator.shuffle(groups)
    for group in groups:
        generator.shuffle(group)
    items[:] = [item for group in groups for item in group]


def missing(terminalreporter):
    """Return the number of tests that were skipped for the lack of each program."""
    reasons = [
        str(report.longrepr) for report in terminalreporter.stats.get("skipped", [])
    ]
    counts = {
        name: sum(bool(re.search(pattern, reason, re.IGNORECASE)) for reason in reasons)
        for name, (_, pattern) in REMEDIES.items()
    }
    return {name: count for name, count in counts.items() if count}


def pytest_terminal_summary(terminalreporter):
    for name, count in missing(terminalreporter).items():
        terminalreporter.write_line(
            f"{count} skipped for lack of {name}; to run them: {REMEDIES[name][0]}",
            yellow=True,
        )


@pytest.hookimpl(trylast=True)
def pytest_sessionfinish(session, exitstatus):
    """Fail where nothing may be missing (``KNOWARM_TESTS_COMPLETE=1``, as in ``.ci/run``)."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if (
        os.environ.get("KNOWARM_TESTS_COMPLETE")
        and reporter is not None
        and missing(reporter)
    ):
        session.exitstatus = pytest.ExitCode.TESTS_FAILED
