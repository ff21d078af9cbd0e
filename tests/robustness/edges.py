"""Campaigns at the edges: links of strangers, clocks of robots, sockets, rows of the benchmark."""

import json
import shutil
import socket
import tempfile
import threading
from pathlib import Path

import numpy as np
import pytest

from knowarm.benchmark.rows import read_row
from knowarm.deploy.contract import deployment
from knowarm.errors import UserError
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.load import load_agent
from knowarm.experiment.run_folder import RunFolder
from knowarm.experiment.run_lock import lock_folder
from knowarm.report import write_report
from tests.deploy.test_driver import IMAGE, NAMES, Robot
from tests.robustness.formats import outcome
from tests.robustness.mutator import mutate, mutate_json
from tests.robustness.test_permuted_doors import DOORS, ROWS, Doors
from tests.source_tree import ROOT
from tests.tiny import CHOOSE_NAME

Result = tuple[int, list[str]]


def links(tries: int, seed: int) -> Result:
    """Put a link in a run folder, and use it: no file of the user changes, none is added."""
    random, failures = np.random.default_rng(seed), []
    with tempfile.TemporaryDirectory() as temporary:
        run, mine = Path(temporary) / "runs" / "x" / "0", Path(temporary) / "home"
        mine.mkdir()
        (mine / "bashrc").write_text("mine")

        def lock():
            with lock_folder(run, remedy=""):
                pass

        uses = {
            "open": lambda: RunFolder.open(run),
            "load": lambda: load_agent(run),
            "lock": lock,
            "evaluate": lambda: evaluate(run, episodes=2, probes=()),
            "report": lambda: write_report([run], run.parents[1] / "report.html"),
        }
        source = ROOT / "zoo" / "irb120-full-fast"
        names = [path.relative_to(source).as_posix() for path in source.rglob("*")]
        names += [
            ".lock",
            ".lock.json",
            "metrics.csv",
            "graphs/aa/x.csv",
            "../../report.html",
            "evaluation",
            "evaluation/post-training-greedy",
            "../../report-data",
            "new.json",
            "evaluation/post-training-greedy/summary.json",
            "evaluation/post-training-greedy/steps.parquet",
        ]
        for number in range(tries):
            shutil.rmtree(run.parents[1], ignore_errors=True)
            shutil.copytree(source, run)
            place = run / names[random.integers(len(names))]
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.rmtree(place) if place.is_dir() else place.unlink(missing_ok=True)
            to = (mine / "bashrc", mine, mine / "new")[random.integers(3)]
            place.symlink_to(to)
            use = list(uses)[random.integers(len(uses))]
            what = f"{number}: {use}, {place.relative_to(run.parents[1])} -> {to.name}"
            failed = outcome(uses[use])
            if failed is not None:
                failures.append(f"{what}: {failed}")
            if (mine / "bashrc").read_text() != "mine" or len([*mine.iterdir()]) > 1:
                return number + 1, [*failures, f"{what}: a file of the user changed"]
    return tries, failures


def clocks(tries: int, seed: int) -> Result:
    """Drive with clocks that jump and inputs that repeat: every target keeps the rules."""
    random, failures = np.random.default_rng(seed), []
    for number in range(tries):
        robot = Robot(patience_s=1, following_steps=1000, max_steps=100)
        sent_at, joints, stamps = -np.inf, np.array([0.0, 0.5]), 100.0
        for _ in range(60):
            gap = float(
                random.choice(
                    [0.001, 0.05, 0.1, 0.1, 0.1, 0.1, 2], p=[0.16] * 6 + [0.04]
                )
            )
            robot.now, stamps = robot.now + gap, stamps + gap
            stamps += float(random.choice([0, 0, 0, 0, -1000, 1000, -0.2]))
            ages = random.choice([0.0, 0.0, 0.0, 0.2, 0.5, -0.5], 2)
            image = IMAGE + np.uint8(random.choice([0, random.integers(200)]))
            robot.driver.see(image, stamps - ages[0])
            robot.driver.feel(NAMES, joints, stamps - ages[1])
            before, had_ended = len(robot.calls), robot.driver.end
            targets = robot.driver.tick(stamps)
            if targets is None:
                continue
            wrong = {
                "after the end": had_ended,
                "too early": robot.now - sent_at < 0.08 - 1e-9,
                "after a pause": gap > 1 and sent_at > 0,
                "of old inputs": (abs(ages) > 0.3).any() or len(robot.calls) == before,
                "too far": (abs(targets - joints) > 0.0501).any(),
            }
            failures += [
                f"{number}: a target {what}" for what, is_so in wrong.items() if is_so
            ]
            sent_at, joints = robot.now, targets
    return tries, failures


def sockets(tries: int, seed: int) -> Result:
    """Send a policy server what no client sends: whoever is a client is answered as before."""
    pytest.importorskip("websockets")
    from websockets.exceptions import WebSocketException
    from websockets.sync.client import connect

    from knowarm.deploy.serve import PolicyServer, pack, unpack

    random, failures = np.random.default_rng(seed), []
    parts = deployment(load_agent(ROOT / "zoo" / CHOOSE_NAME))
    joints, rows = parts.contract["joints"], parts.contract["knowledge"]["rows"]
    seen = {"observation/image": np.zeros((64, 64, 3), np.uint8), "prompt": rows[0]}
    good = pack(seen | {"observation/state": np.array(joints["home"])})
    server = PolicyServer(parts.runner, port=0)
    threading.Thread(target=server.run, daemon=True).start()
    url = f"ws://127.0.0.1:{server.port}"

    def answer():
        with connect(url, compression=None) as link:
            link.recv(30)
            link.send(good)
            return unpack(link.recv(30))["actions"].tolist()

    expected, idle = answer(), []
    for number in range(tries):
        kind = random.integers(3)
        if kind == 0:  # idle sockets, and a part of a handshake
            idle = [*idle, socket.create_connection(("127.0.0.1", server.port), 30)][
                -40:
            ]
            idle[-1].sendall(
                b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n"[: random.integers(34)]
            )
        elif kind == 1:
            with socket.create_connection(("127.0.0.1", server.port), 30) as one:
                one.sendall(random.bytes(int(random.integers(1, 400))))
        else:
            try:
                with connect(url, compression=None) as link:
                    link.recv(30)
                    link.send(mutate(good, random))
                    said = link.recv(30)
                    failures += [f"{number}: {said!r:.99}"] * (
                        isinstance(said, str) and "\n" in said
                    )
            except (WebSocketException, OSError) as error:
                failures += [f"{number}: no answer: {error}"] * isinstance(
                    error, TimeoutError
                )
        if number % 5 == 4:
            try:
                failures += [f"{number}: another answer"] * (answer() != expected)
            except (WebSocketException, OSError) as error:
                failures.append(f"{number}: a client is not served: {error!r}")
    server.close()
    return tries, failures


def forged_rows(tries: int, seed: int) -> Result:
    """Change a value of a row: it is refused in one line, or every figure is as before."""
    random, failures, paths = np.random.default_rng(seed), [], sorted(ROWS.iterdir())
    with tempfile.TemporaryDirectory() as folder:
        forged = Path(folder) / "row.json"
        for number in range(tries):
            text = paths[random.integers(len(paths))].read_bytes()
            forged.write_bytes(mutate_json(text, random))
            try:
                row = read_row(forged)
            except UserError as error:
                failures += [f"{number}: several lines"] * ("\n" in str(error))
                continue
            except Exception as error:
                failures.append(f"{number}: {type(error).__name__}: {error}")
                continue
            figures = [(name, cell["success"]) for name, cell in row["cells"].items()]
            stored = [
                (name, cell["success"])
                for name, cell in json.loads(text)["cells"].items()
            ]
            failures += [f"{number}: {forged.read_bytes()!r:.99}"] * (figures != stored)
    return tries, failures


def permuted_doors(tries: int, seed: int) -> Result:
    """Try the public doors in turn with other forms of the input; see `test_permuted_doors`."""
    failures = []
    with tempfile.TemporaryDirectory() as folder:
        doors = Doors(load_agent(ROOT / "zoo" / CHOOSE_NAME), Path(folder))
        for number in range(tries):
            door = DOORS[number % len(DOORS)]
            found = door(doors, np.random.default_rng([seed, number]))
            failures += [f"{number}, {door.__name__}: {each}" for each in found]
    return tries, failures
