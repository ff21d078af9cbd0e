"""Tests of ``benchmarks/gpu.sh`` on the CPU device, without network."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import torch

from benchmarks import gpu_pack

ROOT = Path(__file__).parent.parent.parent
STAGES = ("smoke", "parity", "bench", "train")
REQUIREMENTS = [ROOT / "benchmarks" / f"gpu-{name}.txt" for name in ("requirements", "machine")]


def gpu_sh(folder: Path, *arguments: str, **settings: str) -> subprocess.CompletedProcess[str]:
    """Run the script with this interpreter and a folder for all files, without a time limit."""
    environment = os.environ | {"DEVICE": "cpu", "TINY": "1", "PYTHON": sys.executable}
    environment |= {"LIMIT_S": "86400"}
    return subprocess.run(
        [str(ROOT / "benchmarks" / "gpu.sh"), *(arguments or ("", str(folder / "out")))],
        env=environment | {"WORK": str(folder / "work")} | settings,
        capture_output=True,
        text=True,
    )


@pytest.fixture
def warp_cache() -> dict[str, str]:
    """Return the setting for Warp's own cache, so that other tests' kernels need no compilation."""
    warp = pytest.importorskip("warp")
    pytest.importorskip("mujoco_warp")
    warp.init()
    return {"WARP_CACHE_PATH": warp.config.kernel_cache_dir}


@pytest.mark.slow(40)
def test_every_stage_runs_on_the_cpu_device(tmp_path: Path, warp_cache: dict[str, str]) -> None:
    done = gpu_sh(tmp_path, **warp_cache)
    assert done.returncode == 0, done.stdout + done.stderr
    out = tmp_path / "out"
    curve = {"metrics.csv", "evaluations.csv", "config.json", "provenance.json"}
    assert {path.name for path in out.iterdir()} == {"gpu.json", "smoke.txt", "parity.txt"} | curve
    result = json.loads((out / "gpu.json").read_text())
    assert [row["num_envs"] for row in result["rows"]] == [4, 8]
    assert result["env_steps_per_s"] > 0
    assert result["training_steps_per_s"] > 0
    assert result["training"]["finished"]
    assert result["training"]["evaluations"] == 3
    assert result["training"]["minutes"] > 0
    assert result["training_minutes_70m"] is None, "this was not the whole run"
    assert re.search(r"\d+ passed", (out / "parity.txt").read_text())
    assert done.stdout.count("80 of 80 steps") == 1

    again = gpu_sh(tmp_path, STAGES="train", **warp_cache)
    assert again.returncode == 0, again.stdout + again.stderr
    assert "Trained for" not in again.stdout
    assert json.loads((out / "gpu.json").read_text()) == result


BENCH = {"machine": {"gpu": None}, "rows": [], "ceilings": {}}
"""Result of the stage `bench` without a row."""

TIMEOUT = """#!/usr/bin/env bash
# In place of timeout: sends SIGTERM to a training once it has logged two more rows of metrics.
while [[ $1 == --* ]]; do shift; done
shift
rows() { cat "$WORK/runs/$RUN/metrics.csv" 2> /dev/null | wc -l; }
before=$(rows)
"$@" &
if [[ " $* " == *" train "* ]]; then
  while kill -0 $! 2> /dev/null && (($(rows) < before + 2)); do sleep 0.1; done
  kill -TERM $! 2> /dev/null
fi
wait $!
"""


@pytest.mark.slow(30)
def test_a_stopped_training_is_resumed(tmp_path: Path, warp_cache: dict[str, str]) -> None:
    programs = tmp_path / "programs"
    programs.mkdir()
    (programs / "timeout").write_text(TIMEOUT)
    (programs / "timeout").chmod(0o755)
    sizes = "--total-steps 1000000 --checkpoint-every-steps 1000000"
    stop = {"PATH": f"{programs}:{os.environ['PATH']}", "RUN": "irb120-full-ppo/0"} | warp_cache
    (tmp_path / "work").mkdir()
    (tmp_path / "work" / "gpu.json").write_text(json.dumps(BENCH))
    stopped = gpu_sh(tmp_path, STAGES="train", TRAIN_OPTIONS=sizes, **stop)
    assert stopped.returncode == 1, stopped.stdout + stopped.stderr
    assert "call again with STAGES=train" in stopped.stderr, stopped.stdout + stopped.stderr
    json_path = tmp_path / "out" / "gpu.json"
    first = json.loads(json_path.read_text())["training"]
    assert 0 < first["step"] < 1_000_000
    assert not first["finished"]

    stopped = gpu_sh(tmp_path, STAGES="train", **stop)
    assert "call again with STAGES=train" in stopped.stderr, stopped.stdout + stopped.stderr
    second = json.loads(json_path.read_text())["training"]
    assert second["step"] > first["step"]
    assert second["minutes"] > first["minutes"]
    assert len((tmp_path / "work" / "times").read_text().splitlines()) == 2


def write_pack(folder: Path, bytes_per_part: int) -> list[Path]:
    """Write an archive of a package with one module and of one file of Warp's cache, in parts."""
    site, cache = folder / "made" / "site", folder / "made" / "cache"
    for path, text in {
        site / "gpu_probe.py": "answer = 42\n",
        site / "gpu_probe-1.0.dist-info" / "METADATA": "Name: gpu-probe\nVersion: 1.0\n",
        cache / "1.19.0" / "module.cubin": "code",
    }.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    archive = folder / "made" / "site.tar.xz"
    gpu_pack.write_archive(archive, **{"site": site, "warp-cache": cache})
    return gpu_pack.split(archive, folder / "pack", bytes_per_part)


def test_a_pack_is_joined_and_its_packages_are_found(tmp_path: Path) -> None:
    pytest.importorskip("mujoco_warp")
    parts = write_pack(tmp_path, 200)
    assert len(parts) > 1
    assert parts[0] == tmp_path / "pack" / "1" / f"site.tar.xz.1of{len(parts)}"
    out = str(tmp_path / "out")
    for _ in range(2):  # the second call finds everything unpacked
        done = gpu_sh(tmp_path, str(tmp_path / "pack"), out, STAGES="")
        assert done.returncode == 0, done.stdout + done.stderr
    assert "mujoco-warp 4" in done.stdout
    work = tmp_path / "work"
    assert "42" in (work / "pack" / "site" / "gpu_probe.py").read_text()
    assert (work / "warp-cache" / "1.19.0" / "module.cubin").is_file()
    parts[-1].unlink()
    done = gpu_sh(tmp_path, str(tmp_path / "pack"), out, STAGES="")
    assert done.returncode == 1
    assert f"only {len(parts) - 1} of {len(parts)} parts are" in done.stderr


def calls_of(printed: str) -> list[tuple[int, int, str]]:
    """Return bytes, seconds and command of each call that a dry run printed."""
    calls = re.findall(r"^call \d+: (\d+) kB, about (\d+) s: (.*)$", printed, re.MULTILINE)
    return [(1000 * int(size), int(seconds), command) for size, seconds, command in calls]


def test_a_dry_run_prints_each_call_and_does_nothing(tmp_path: Path) -> None:
    parts = write_pack(tmp_path, 200)
    pack, out = str(tmp_path / "pack"), str(tmp_path / "out")
    settings = {"DRY_RUN": "1", "LIMIT_S": "480"}
    done = gpu_sh(tmp_path, pack, out, **settings, DEVICE="cuda")
    assert done.returncode == 0, done.stderr
    calls = calls_of(done.stdout)
    copies = [f"mkdir -p /tmp/pack && cp {part.parent}/* /tmp/pack" for part in parts]
    stages = [f"STAGES={name} benchmarks/gpu.sh /tmp/pack" for name in STAGES]
    assert [command for *_, command in calls] == [
        *copies[:-1],
        f"{copies[-1]} && {stages[0]}",
        *stages[1:],
    ]
    # The last transfer, unpacking and the first stage are one call.
    seconds = [60] * (len(parts) - 1) + [60 + 30 + 90, 240, 135, 410]
    assert [each for _, each, _ in calls] == seconds
    assert f"{len(calls)} calls, about {sum(seconds) // 60} minutes" in done.stdout
    checkout = int(re.search(r"the checkout: (\d+) kB", done.stdout).group(1)) * 1000
    assert checkout > 10**6
    assert all(abs(size - checkout) <= 1000 for size, *_ in calls), "parts of 200 bytes"
    assert not Path(out).exists()

    only = gpu_sh(tmp_path, "", out, **settings, STAGES="bench")
    assert calls_of(only.stdout) == [(checkout, 135, "STAGES=bench DEVICE=cpu benchmarks/gpu.sh")]


@pytest.mark.parametrize(
    ("size", "settings", "words"),
    [
        (48_000_001, {}, "site.tar.xz.1of1 has more than 48 MB"),
        (1, {"LIMIT_S": "100"}, "call 1 takes longer than LIMIT_S=100 s"),
        (1, {"STAGES": "train train train train train"}, "this is more than 30 minutes"),
    ],
)
def test_a_dry_run_checks_limits(
    size: int, settings: dict[str, str], words: str, tmp_path: Path
) -> None:
    (part,) = write_pack(tmp_path, 10**6)
    with part.open("wb") as file:
        file.truncate(size)
    options = {"DRY_RUN": "1", "LIMIT_S": "600"} | settings
    done = gpu_sh(tmp_path, str(tmp_path / "pack"), str(tmp_path / "out"), **options)
    assert done.returncode == 1
    assert words in done.stderr


def test_damaged_parts_and_those_of_another_pack_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("mujoco_warp")
    parts = write_pack(tmp_path, 200)
    arguments = str(tmp_path / "pack"), str(tmp_path / "out")
    whole = parts[0].read_bytes()
    parts[0].write_bytes(whole[:100] + bytes([whole[100] ^ 1]) + whole[101:])
    done = gpu_sh(tmp_path, *arguments, STAGES="")
    assert done.returncode == 1
    assert "have another digest than site.tar.xz.sha256" in done.stderr
    parts[0].write_bytes(whole)
    digest = parts[0].with_name("site.tar.xz.sha256")
    digest.write_text("0" * 64 + "\n")
    done = gpu_sh(tmp_path, *arguments, STAGES="")
    assert done.returncode == 1
    assert "have another digest than site.tar.xz.sha256" in done.stderr


RECORDER = """#!/usr/bin/env bash
# In place of timeout and of Python: notes its name and arguments, and runs nothing.
echo "${0##*/} $*" >> "$NOTES"
"""


def test_commands_of_a_gpu_have_the_whole_sizes_and_a_limit(tmp_path: Path) -> None:
    for name in ("timeout", "python"):
        program = tmp_path / "programs" / name
        program.parent.mkdir(exist_ok=True)
        program.write_text(RECORDER)
        program.chmod(0o755)
    (tmp_path / "work").mkdir()
    (tmp_path / "work" / "gpu.json").write_text("{}")
    settings = {
        "DEVICE": "cuda",
        "TINY": "",
        "LIMIT_S": "",
        "PYTHON": str(tmp_path / "programs" / "python"),
        "PATH": f"{tmp_path / 'programs'}:{os.environ['PATH']}",
        "NOTES": str(tmp_path / "notes"),
    }
    out = tmp_path / "results"
    done = gpu_sh(tmp_path, "", STAGES="smoke bench train", OUT=str(out), **settings)
    assert done.returncode == 0, done.stdout + done.stderr
    assert {path.name for path in out.iterdir()} == {"gpu.json", "smoke.txt"}
    notes = (tmp_path / "notes").read_text().splitlines()
    smoke, bench, train = (line for line in notes if line.startswith("timeout"))
    assert all(re.search(r"^timeout (--\S+ )*480 ", line) for line in (smoke, bench, train))
    assert smoke.endswith("-m benchmarks.gpu_smoke --device cuda")
    assert "--num-envs 256 1024 4096 16384 --seconds 5" in bench
    assert "train irb120-full-ppo" in train
    for option in (
        "--algorithm.device cuda",
        "--total-steps 70000000",
        "--algorithm.num-envs 4096",
        "--algorithm.minibatches 16",
        "--interim.every-steps 500000",
        "--checkpoint-every-steps 10000000",
    ):
        assert option in train


@pytest.mark.parametrize(
    ("arguments", "settings", "words"),
    [
        ((), {"STAGES": "bench fly"}, "unknown stage 'fly'"),
        ((), {"DEVICE": "tpu"}, "DEVICE must be cuda or cpu"),
        (("/nowhere",), {}, "/nowhere does not exist"),
        ((str(ROOT / "benchmarks"),), {}, "there is no part of an archive"),
        ((), {"STAGES": "train"}, "run the stage bench first"),
        pytest.param(
            (),
            {"DEVICE": "cuda"},
            "torch finds no GPU",
            marks=pytest.mark.skipif(torch.cuda.is_available(), reason="there is a CUDA device"),
        ),
    ],
)
def test_mistakes_are_named(
    arguments: tuple[str, ...], settings: dict[str, str], words: str, tmp_path: Path
) -> None:
    if arguments:
        arguments = (*arguments, str(tmp_path / "out"))
    done = gpu_sh(tmp_path, *arguments, **settings)
    assert done.returncode == 1
    assert words in done.stderr


def required(lines: list[str]) -> set[str]:
    names = (re.match(r"[A-Za-z0-9_.-]+", line.strip()) for line in lines)
    return {name.group().lower() for name in names if name}


def test_the_requirements_contain_all_dependencies() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = required(project["dependencies"] + project["optional-dependencies"]["gpu"])
    carried, there = (required(path.read_text().splitlines()) for path in REQUIREMENTS)
    assert needed <= carried | there
    assert not carried & there
    viewers = {"glfw", "mujoco-studio", "pyopengl"}
    assert not viewers & carried
