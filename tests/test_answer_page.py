"""The page on the paper's claim follows from the packs."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.slow(8)
def test_the_page_is_what_the_packs_say(tmp_path):
    out = tmp_path / "answer.md"
    command = [sys.executable, "-m", "scripts.build_answer", "--out", out]
    subprocess.run(command, check=True, cwd=ROOT)
    committed = ROOT / "docs" / "results" / "answer.md"
    assert out.read_text("utf-8") == committed.read_text("utf-8")
