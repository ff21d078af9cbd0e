"""A script that trains needs no main guard."""

import subprocess
import sys

import pytest

SCRIPT = """
import knowarm

run = knowarm.train(
    "irb120-full-fast",
    total_steps=400,
    algorithm={"processes": 2, "num_envs": 16, "minibatches": 2},
    interim={"episodes": 2},
)
print("trained", run.result.step)
"""


@pytest.mark.slow(15)
def test_a_script_without_a_guard_trains_with_child_processes(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, script],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("trained") == 1
