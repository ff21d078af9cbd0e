"""Campaigns against every command that writes files: kill -9, full disks, and another user."""

import ctypes
import os
import random
import re
import shutil
import struct
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http.server import ThreadingHTTPServer
from pathlib import Path

import psutil

from knowarm.cli.main import main
from knowarm.experiment.run import train
from knowarm.knowledge.formats import shipped_graph
from knowarm.world.robots import find_robot
from tests.experiment.test_hub import Hub
from tests.forked import Forked
from tests.robustness.packs import pack_readers
from tests.tiny import short

COMMANDS = {
    "evaluate": ("evaluate", "run", "--episodes", "2", "--blind-episodes", "0"),
    "report": ("report", "run", "--out", "out/report.html"),
    "export": ("export", "run", "--to", "out"),
    "record": ("record", "zero", "--to", "out", "--episodes", "2"),
    "doctor": ("doctor", "--robot", "arm.xml", "--write", "out.toml"),
    "view": ("view", "--episodes", "1", "--no-browser", "--page", "out.html"),
    "film": ("view", "--episodes", "1", "--no-browser", "--video", "out.mp4"),
    "graph": ("knowledge", "subgraph", "--graph", "objects", "--out", "out.ttl"),
    "drawing": ("knowledge", "draw", "--objects", "mug", "--out", "out.svg"),
    "embedding": ("knowledge", "fit", "--graph", "tiny.tsv", "--out", "out.safetensors"),
    "unpack": ("study", "unpack", "pack.tar.xz", "--out", "out"),
    "pull": ("hub", "pull", "someone/policy", "--to", "out"),
    "benchmark": ("benchmark", "run", "reach-v1", "--policy", "zero", "--out", "out.json"),
}  # fmt: skip
"""What is killed, in a folder with a run, a robot, a graph and a pack."""
EDITED = {"benchmark": ("--cells", "tiago-fixed"), "embedding": ("--epochs", "2")}
GONE_S = 60
KNOWN = find_robot("irb120").mjcf


def kill_commands(tries: int, seed: int) -> tuple[int, list[str]]:
    """Kill each command that many times; what it leaves is whole, and it succeeds afterwards."""
    failures = []
    with tempfile.TemporaryDirectory() as temporary, _hub() as environment:
        root = Path(temporary)
        inputs = root / "inputs"
        _prepare(inputs, root)
        for name in COMMANDS:
            draws = random.Random(f"{name} {seed}")
            found = _kill(name, inputs, root / name, tries, draws, environment)
            failures.extend(f"{name}: {what}" for what in found)
    return tries * len(COMMANDS), failures


def _kill(
    name: str,
    inputs: Path,
    folder: Path,
    tries: int,
    draws: random.Random,
    environment: dict[str, str],
) -> Iterator[str]:
    """Yield what is wrong after kills in one folder, and after an undisturbed run there."""
    wholes = []
    for number in range(2):
        whole = folder.with_name(f"{name}-{number}")
        shutil.copytree(inputs, whole)
        began = time.monotonic()
        done = _start(name, whole, environment)
        done.ended(600)
        seconds = time.monotonic() - began
        if done.returncode:
            yield f"fails undisturbed: {done.stderr[-300:]}"
            return
        wholes.append(_files(whole))
    shutil.copytree(inputs, folder)
    for _ in range(tries):
        running = _start(name, folder, environment)
        running.ended(draws.uniform(0, 1.1 * seconds))
        with suppress(ProcessLookupError):
            os.kill(running.process.pid, 9)
        running.process.join()
        if _left(running.process.pid):
            yield "a process is left"
        if running.returncode not in (0, -9):
            yield f"ends with {running.returncode}: {running.stderr[-300:]}"
        files = _files(folder)
        yield from _damage(files, *wholes)
        if wholes[0].keys() <= files.keys():  # new files and folders are written once
            shutil.rmtree(folder)
            shutil.copytree(inputs, folder)
    done = _start(name, folder, environment)
    done.ended(600)
    if done.returncode:
        yield f"fails afterwards: {done.stderr[-300:]}"
    if missing := wholes[0].keys() - _files(folder).keys():
        yield f"lacks {', '.join(missing)}"


def refuse_writes(tries: int, seed: int) -> tuple[int, list[str]]:
    """Let files be limited, a disk be full, or the folder belong to another user: one line."""
    draws = random.Random(seed)
    failures = []
    with tempfile.TemporaryDirectory() as temporary, _hub() as environment:
        root = Path(temporary)
        root.chmod(0o755)
        inputs = root / "inputs"
        _prepare(inputs, root)
        before = _files(inputs)
        for number in range(tries):
            name = draws.choice(list(COMMANDS))
            kind = draws.choice(KINDS)
            size = 2 ** draws.randint(12, 21)  # more than a line of an error
            folder = root / str(number)
            with _refusing(kind, folder, size) as refuse:
                shutil.copytree(inputs, folder, dirs_exist_ok=True)
                done = _start(name, folder, environment, refuse)
                done.ended(600)
                where = f"{name}, {kind} {size}"
                if done.returncode not in (0, 2):
                    failures.append(f"{where}: exit code {done.returncode}")
                last = done.stderr.rstrip("\n").rpartition("\n")[2]
                if done.returncode and not re.match(LAST, last):
                    failures.append(f"{where}: {done.stderr[-300:]}")
                if "Traceback" in done.stderr:
                    failures.append(f"{where}: {done.stderr[-300:]}")
                failures += [f"{where}: {d}" for d in _damage(_files(folder), before)]
    return tries, failures


LAST = "knowarm: (?!warning)"
"""Beginning of the line in which a command ends."""
KINDS = ["files"]
if os.name == "posix" and os.geteuid() == 0:
    KINDS += ["disk", "user"]


@contextmanager
def _refusing(kind: str, folder: Path, size: int) -> Iterator[Callable[[], object]]:
    """Yield what a process calls before it cannot write more than a size."""
    import resource

    folder.mkdir()
    if kind == "files":
        yield lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
    elif kind == "user":
        yield lambda: _give_away(folder)
    else:
        blocks = 65536  # [KiB], all but so many bytes filled
        command = ["mount", "-t", "tmpfs", "-o", f"size={blocks}k", "tmpfs"]
        subprocess.run([*command, folder], check=True)
        try:
            yield lambda: _fill(folder / ".full", size)
        finally:
            subprocess.run(["umount", folder], check=True)


def _give_away(folder: Path) -> None:
    """Give a folder to another user, and lose root's right to write there all the same."""
    for path in (folder, *folder.rglob("*")):
        os.chown(path, 65534, 65534)
    version = struct.pack("Ii", 0x20080522, 0)
    assert ctypes.CDLL(None).capset(version, bytes(24)) == 0


def _fill(file: Path, free: int) -> None:
    """Fill a disk but for so many bytes."""
    state = os.statvfs(file.parent)
    file.write_bytes(bytes(max(0, state.f_bavail * state.f_frsize - free)))


def _damage(files: dict[str, bytes], *wholes: dict[str, bytes]) -> Iterator[str]:
    """Yield which files are empty, or differ from those of undisturbed runs that are equal."""
    for name, data in files.items():
        expected = {whole.get(name) for whole in wholes}
        if not data and b"" not in expected:
            yield f"{name} is empty"
        elif len(expected) == 1 and expected.isdisjoint({data, None}):
            yield f"{name} has {len(data)} other bytes"


def _start(
    name: str,
    folder: Path,
    environment: dict[str, str],
    before: Callable[[], object] = int,
) -> Forked:
    arguments = (*COMMANDS[name], *EDITED.get(name, ()))

    def run() -> int:
        os.setsid()
        before()
        return main(arguments)

    return Forked(
        run,
        folder.parent,
        cwd=folder,
        environment=environment,
        forget=["huggingface_hub"],
    )


def _left(group: int) -> list[int]:
    """Return the processes of a group that stay."""
    deadline = time.monotonic() + GONE_S
    while True:
        left = []
        for process in psutil.process_iter():
            with suppress(psutil.Error, ProcessLookupError):
                is_zombie = process.status() == psutil.STATUS_ZOMBIE
                if os.getpgid(process.pid) == group and not is_zombie:
                    left.append(process.pid)
        if not left or time.monotonic() > deadline:
            return left
        time.sleep(0.1)


def _files(folder: Path) -> dict[str, bytes]:
    """Return the content of files by name; of hidden ones, which are no results, nothing."""
    files = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder)
        if path.is_file() and not any(part.startswith(".") for part in name.parts):
            files[str(name)] = path.read_bytes()
    return files


def _prepare(folder: Path, root: Path) -> None:
    """Write a run, a robot, a graph and a pack."""

    def make() -> None:
        run = train(short(total_steps=80), root / "runs", policy={"features": 8})
        shutil.copytree(run.folder.path, folder / "run")

    folder.mkdir()
    made = Forked(make, root)
    assert made.ended(600)
    assert made.returncode == 0, made.stderr
    shutil.copy(KNOWN, folder / "arm.xml")
    triples = list(shipped_graph("objects"))[:200]
    (folder / "tiny.tsv").write_text("".join("\t".join(t) + "\n" for t in triples))
    _, pack, _ = pack_readers(root / "packs")[0]
    shutil.copy(pack, folder)
    Hub.repos = {
        "someone/policy": {
            str(path.relative_to(folder)): path.read_bytes()
            for path in (folder / "run").rglob("*")
            if path.is_file()
        }
    }


@contextmanager
def _hub() -> Iterator[dict[str, str]]:
    """Serve a stub of the Hub; yield the settings that lead to it."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), Hub)
    server.handle_error = lambda *_: None  # clients that were killed
    threading.Thread(target=server.serve_forever, daemon=True).start()
    yield {
        "HF_ENDPOINT": f"http://127.0.0.1:{server.server_address[1]}",
        "HF_HUB_DISABLE_XET": "1",
        "HF_TOKEN": "hf_test",
    }
    server.shutdown()
    server.server_close()
