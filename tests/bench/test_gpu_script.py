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


@pytest.mark.slow
def test_every_stage_runs_on_the_cpu_device(tmp_path: Path) -> None:
    pytest.importorskip("mujoco_warp")
    done = gpu_sh(tmp_path)
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

    again = gpu_sh(tmp_path, STAGES="bench train")
    assert again.returncode == 0, again.stdout + again.stderr
    assert "Trained for" not in again.stdout
    assert json.loads((out / "gpu.json").read_text()) == result


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


@pytest.mark.slow
def test_a_stopped_training_is_resumed(tmp_path: Path) -> None:
    pytest.importorskip("mujoco_warp")
    programs = tmp_path / "programs"
    programs.mkdir()
    (programs / "timeout").write_text(TIMEOUT)
    (programs / "timeout").chmod(0o755)
    sizes = "--total-steps 1000000 --checkpoint-every-steps 1000000"
    stop = {"PATH": f"{programs}:{os.environ['PATH']}", "RUN": "irb120-full-ppo/0"}
    options = {"BENCH_OPTIONS": "--no-training", "TRAIN_OPTIONS": sizes}
    stopped = gpu_sh(tmp_path, STAGES="bench train", **options, **stop)
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


def test_a_dry_run_prints_sizes_times_and_commands_and_does_nothing(tmp_path: Path) -> None:
    write_pack(tmp_path, 10**6)
    pack = tmp_path / "pack"
    done = gpu_sh(tmp_path, str(pack), str(tmp_path / "out"), DRY_RUN="1", LIMIT_S="480")
    assert done.returncode == 0, done.stderr
    assert re.search(r"transfer of \d+ kB: site.tar.xz.1of1 0 kB, the checkout \d+ kB", done.stdout)
    for stage, seconds in (("smoke", 90), ("parity", 240), ("bench", 135), ("train", 410)):
        line = f"about {seconds} s, at most 480 s: STAGES={stage} DEVICE=cpu benchmarks/gpu.sh"
        assert line in done.stdout
    assert "in all about 14 minutes" in done.stdout
    assert not (tmp_path / "out").exists()
    with (pack / "1" / "site.tar.xz.1of1").open("wb") as file:
        file.truncate(48_000_001)
    done = gpu_sh(tmp_path, str(pack), str(tmp_path / "out"), DRY_RUN="1")
    assert done.returncode == 1
    assert "site.tar.xz.1of1 has more than 48 MB" in done.stderr


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
