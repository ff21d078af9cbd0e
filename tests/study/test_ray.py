"""The Ray executor on a real cluster: two nodes, token authentication, a lost node and driver."""

import json
import os
import secrets
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from knowarm.study.driver import open_study
from knowarm.study.status import study_status
from tests.robustness.study_storm import results

pytest.importorskip("ray")
pytestmark = pytest.mark.slow

STUDY = """
name = "cluster"
experiments = ["irb120-bm-ppo"]
seeds = [0, 1, 2]

[overrides]
total_steps = 1600
checkpoint_every_steps = 100
interim = {every_steps = 800, episodes = 2}
algorithm = {num_envs = 4, rollout_steps = 5, minibatches = 2, processes = 1}

[[evaluations]]
episodes = 3
blind_episodes = 0

[where]
memory_gib = 0.5
kind = "ray"
"""
RAY = [sys.executable, "-c", "from ray.scripts.scripts import main; main()"]


def free_port() -> int:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        return server.getsockname()[1]


def kill_tree(process: subprocess.Popen) -> None:
    try:
        tree = [*psutil.Process(process.pid).children(recursive=True), process]
    except psutil.NoSuchProcess:
        return
    for each in tree:
        try:
            each.kill()
        except psutil.NoSuchProcess:
            continue
    process.wait()


class Cluster:
    """A head node and a second node, each with one core."""

    def __init__(self, folder: Path) -> None:
        self.environment = {
            **os.environ,
            "RAY_AUTH_MODE": "token",
            "RAY_AUTH_TOKEN": secrets.token_hex(32),
            "RAY_USAGE_STATS_ENABLED": "0",
        }
        self.port = free_port()
        self.head = self._start(
            "--head",
            f"--port={self.port}",
            "--include-dashboard=false",
            f"--temp-dir={folder}",
        )
        self.wait_for_nodes(1)
        self.other = self._start(f"--address=127.0.0.1:{self.port}")
        self.wait_for_nodes(2)

    def _start(self, *arguments: str) -> subprocess.Popen:
        common = ["--block", "--num-cpus=1", "--object-store-memory=100000000"]
        return subprocess.Popen(
            [*RAY, "start", *arguments, "--node-ip-address=127.0.0.1", *common],
            env=self.environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def wait_for_nodes(self, count: int) -> None:
        code = (
            "import ray, sys; ray.init(address=sys.argv[1], log_to_driver=False); "
            "print(sum(node['Alive'] for node in ray.nodes()))"
        )
        end = time.monotonic() + 120
        while time.monotonic() < end:
            asking = subprocess.Popen(
                [sys.executable, "-c", code, f"127.0.0.1:{self.port}"],
                env=self.environment,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
            try:
                if asking.communicate(timeout=60)[0].strip() == str(count):
                    return
            except subprocess.TimeoutExpired:
                kill_tree(asking)  # Ray waits for ever for a node that has died
        pytest.fail(f"the cluster has no {count} nodes")

    def study(self, study: Path, out: Path, **environment: str) -> subprocess.Popen:
        command = [sys.executable, "-m", "knowarm", "study", "run", str(study), "--out", str(out)]
        return subprocess.Popen(
            [*command, "--address", f"127.0.0.1:{self.port}"],
            env={**self.environment, **environment},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )

    def workers(self, node: subprocess.Popen, out: Path) -> list[Path]:
        """Return the run folders that processes of a node hold."""
        tree = {child.pid for child in psutil.Process(node.pid).children(recursive=True)}
        holders = {path.parent: json.loads(path.read_text()) for path in out.glob("*/*/.lock.json")}
        return [run for run, holder in holders.items() if holder["pid"] in tree]


@pytest.fixture
def cluster():
    # Paths of sockets must be short.
    folder = Path("/tmp") / f"ray-{os.getpid()}"
    try:
        cluster = Cluster(folder)
        yield cluster
        for node in (cluster.other, cluster.head):
            kill_tree(node)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def wait_until(condition, timeout_s: float = 300.0) -> None:
    end = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.2)


@pytest.mark.slow(50)
@pytest.mark.skipif(" " in sys.executable, reason="Ray cannot start from a path with a space")
def test_a_study_survives_the_loss_of_a_node_and_of_its_driver(tmp_path, cluster):
    study = tmp_path / "study.toml"
    study.write_text(STUDY)
    out, calm = tmp_path / "ray", tmp_path / "calm"

    def steps(run: Path) -> int:
        path = run / "metrics.csv"
        return len(path.read_text().splitlines()) if path.exists() else 0

    def is_learning_on(node: subprocess.Popen) -> bool:
        return any(steps(run) > 8 for run in cluster.workers(node, out))

    driver = cluster.study(study, out)
    wait_until(lambda: is_learning_on(cluster.head) and is_learning_on(cluster.other))
    (lost,) = cluster.workers(cluster.other, out)
    kill_tree(cluster.other)
    wait_until(lambda: lost in cluster.workers(cluster.head, out))
    wait_until(lambda: is_learning_on(cluster.head))
    driver.kill()
    driver.communicate()
    driver = cluster.study(study, out)
    said, _ = driver.communicate(timeout=600)
    assert driver.returncode == 0, said
    assert {each.state for each in study_status(open_study(out), out)} == {"done"}
    assert "resuming at step" in (lost / "log.txt").read_text()
    local = study.with_name("local.toml")
    local.write_text(STUDY.replace('kind = "ray"', 'kind = "local"'))
    command = [sys.executable, "-m", "knowarm", "study", "run", str(local), "--out", str(calm)]
    subprocess.run(command, check=True, capture_output=True)
    assert results(out) == results(calm)

    refused = cluster.study(study, tmp_path / "no", RAY_AUTH_TOKEN=secrets.token_hex(32))
    said, _ = refused.communicate(timeout=120)
    assert refused.returncode == 2
    assert "RAY_AUTH_TOKEN" in said
    study.write_text(STUDY.replace("memory_gib", "cores = 3\nmemory_gib"))
    large = cluster.study(study, tmp_path / "no")
    said, _ = large.communicate(timeout=120)
    assert (large.returncode, "no node" in said) == (2, True), said
    assert not (tmp_path / "no").exists()
