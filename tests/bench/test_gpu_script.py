"""Tests of ``benchmarks/gpu.sh`` on the CPU device, without network."""

import json
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).parent.parent.parent
REQUIREMENTS = ROOT / "benchmarks" / "gpu-requirements.txt"


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
    assert {path.name for path in out.iterdir()} == {"gpu.json", "parity.txt"} | curve
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


def write_wheel(path: Path) -> None:
    """Write the wheel of a package with one module."""
    info = f"{path.name.split('-')[0]}-1.0.dist-info"
    files = {
        "gpu_probe.py": "answer = 42\n",
        f"{info}/METADATA": "Metadata-Version: 2.1\nName: gpu-probe\nVersion: 1.0\n",
        f"{info}/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    }
    record = "".join(f"{name},,\n" for name in (*files, f"{info}/RECORD"))
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in {**files, f"{info}/RECORD": record}.items():
            archive.writestr(name, text)


def test_split_wheels_are_installed_beside_the_packages_of_python(tmp_path: Path) -> None:
    pytest.importorskip("mujoco_warp")
    whole, wheels = tmp_path / "gpu_probe-1.0-py3-none-any.whl", tmp_path / "wheels"
    write_wheel(whole)
    wheels.mkdir()
    content = whole.read_bytes()
    (wheels / f"{whole.name}.partaa").write_bytes(content[:300])
    (wheels / f"{whole.name}.partab").write_bytes(content[300:])
    for _ in range(2):  # the second call finds everything installed
        done = gpu_sh(tmp_path, str(wheels), str(tmp_path / "out"), STAGES="")
        assert done.returncode == 0, done.stdout + done.stderr
    assert "mujoco-warp 4" in done.stdout
    python = tmp_path / "work" / "venv" / "bin" / "python"
    found = subprocess.run(
        [str(python), "-c", "import gpu_probe, torch; print(gpu_probe.answer)"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout == "42\n"


def test_a_dry_run_prints_sizes_and_commands_and_does_nothing(tmp_path: Path) -> None:
    wheels = tmp_path / "wheels"
    wheels.mkdir()
    (wheels / "a-1.0-py3-none-any.whl.partaa").write_bytes(b"x" * 3000)
    done = gpu_sh(tmp_path, str(wheels), str(tmp_path / "out"), DRY_RUN="1", LIMIT_S="480")
    assert done.returncode == 0, done.stderr
    assert "3 kB  a-1.0-py3-none-any.whl.partaa" in done.stdout
    assert "files in all: 3 kB, in 1 transfers of at most 48 MB" in done.stdout
    for stage in ("parity", "bench", "train"):
        assert f"at most 480 s: STAGES={stage} DEVICE=cpu benchmarks/gpu.sh" in done.stdout
    assert not (tmp_path / "out").exists()
    with (wheels / "b-1.0-py3-none-any.whl").open("wb") as file:
        file.truncate(48_000_001)
    done = gpu_sh(tmp_path, str(wheels), str(tmp_path / "out"), DRY_RUN="1")
    assert done.returncode == 1
    assert "b-1.0-py3-none-any.whl has more than 48 MB: split it" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "settings", "words"),
    [
        ((), {"STAGES": "bench fly"}, "unknown stage 'fly'"),
        ((), {"DEVICE": "tpu"}, "DEVICE must be cuda or cpu"),
        (("/nowhere",), {}, "/nowhere does not exist"),
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
    assert needed - {"torch"} <= required(REQUIREMENTS.read_text().splitlines())
