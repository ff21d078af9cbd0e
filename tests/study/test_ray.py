"""A study on a Ray cluster of two nodes of this machine; `make test-ray` installs Ray for it."""

import importlib.util
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from knowarm.errors import UserError
from knowarm.study.config import write_study
from knowarm.study.driver import make_executor, run_study
from knowarm.study.executor import Where
from knowarm.study.status import study_status
from tests.study.tiny import tiny
from tests.tiny import STUDY

HAS_RAY = importlib.util.find_spec("ray") is not None


@pytest.mark.skipif(HAS_RAY, reason="Ray is installed here")
def test_without_ray_the_executor_names_the_remedy(tmp_path):
    with pytest.raises(UserError, match=r"pip install 'knowarm\[ray\]'"):
        make_executor(Where(kind="ray"), tmp_path)


def start_node(*options: str) -> subprocess.Popen:
    """Start a node with one core, in a process group of its own."""
    return subprocess.Popen(
        [
            shutil.which("ray"),
            "start",
            "--block",
            "--num-cpus=1",
            "--memory=2000000000",
            *options,
        ],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


@pytest.fixture
def cluster(tmp_path, monkeypatch):
    """Address and second node of a cluster on the loopback interface."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"127.0.0.1:{port}"
    head = start_node(
        "--head",
        "--node-ip-address=127.0.0.1",
        f"--port={port}",
        "--include-dashboard=false",
        f"--temp-dir={tempfile.mkdtemp()}",  # the paths of its sockets must be short
    )
    monkeypatch.setenv("RAY_ADDRESS", address)
    import ray

    nodes = [head, start_node(f"--address={address}")]
    try:
        deadline = time.monotonic() + 120
        while True:
            try:
                ray.init(address=address, log_to_driver=False)
                if ray.cluster_resources().get("CPU") == 2:
                    break
            except ConnectionError:
                pass
            finally:
                ray.shutdown()
            assert time.monotonic() < deadline, "Ray does not start"
            time.sleep(0.5)
        yield address, nodes[1]
    finally:
        for node in nodes:
            if node.poll() is None:
                os.killpg(node.pid, signal.SIGTERM)
                node.wait()


def weights(out: Path) -> dict[str, bytes]:
    """The trained parameters of every run, by its folder."""
    return {
        str(file.relative_to(out)): file.read_bytes()
        for file in sorted(out.rglob("latest/policy.safetensors"))
    }


@pytest.mark.slow
@pytest.mark.skipif(not HAS_RAY, reason="Ray is not installed here: make test-ray")
def test_a_killed_node_changes_nothing(tmp_path, cluster):
    _, node = cluster
    length = {"total_steps": 4000, "checkpoint_every_steps": 200}
    study = tiny(
        experiments=("irb120-bm-ppo", "irb120-full-ppo"),
        seeds=(0, 1, 2),
        overrides={**STUDY, **length, "interim": {"every_steps": 1000, "episodes": 2}},
        where=Where(memory_gib=0.5),
    )
    run_study(study, tmp_path / "here")
    out = tmp_path / "ray"
    write_study(study, tmp_path)
    command = [sys.executable, "-m", "knowarm", "study", "run", tmp_path]
    driver = subprocess.Popen([*command, "--executor", "ray", "--out", out])
    killed = False
    while driver.poll() is None:
        statuses = study_status(study, out)
        if (
            not killed
            and sum(each.state == "running" and each.step > 0 for each in statuses) == 2
        ):
            os.killpg(node.pid, signal.SIGKILL)
            killed = True
        time.sleep(0.1)
    assert killed
    assert driver.returncode == 0
    assert {each.state for each in study_status(study, out)} == {"done"}
    assert weights(out) == weights(tmp_path / "here")
    assert len(weights(out)) == 6
