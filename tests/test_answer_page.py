"""The page on the paper's claim follows from the packs, and README's answer from the page."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "results" / "answer.md"
NUMBERS = ("four", "five", "six", "seven", "eight", "nine", "ten")


@pytest.mark.slow(8)
def test_the_page_is_what_the_packs_say(tmp_path):
    out = tmp_path / "answer.md"
    command = [sys.executable, "-m", "scripts.build_answer", "--out", out]
    subprocess.run(command, check=True, cwd=ROOT)
    assert out.read_text("utf-8") == PAGE.read_text("utf-8")


def agents_of(cell):
    """Return the seeds and the success of each agent from the table of a cell."""
    section = PAGE.read_text("utf-8").split(f"\n## {cell}\n")[1].split("\n## ")[0]
    rows = re.findall(r"^\| `(.+?)` \| (\d+) \| .+? \| \d+ \| (.+?) \|", section, re.M)
    return {name: (int(seeds), success) for name, seeds, success in rows}


def test_readme_has_the_figures_of_the_page():
    readme = (ROOT / "README.md").read_text("utf-8")
    fewest = []
    for robot, cell in (("irb120", "IRB120, fixed colours"), ("tiago", "TIAGo, fixed colours")):
        for agent in ("bm", "full"):
            ((seeds, success),) = re.findall(
                rf"^\| `{robot}-{agent}-fast`.* mean of (\d+) seeds \| (.+) \|$", readme, re.M
            )
            expected = agents_of(cell)[agent]
            assert (int(seeds), success.replace(" %", "")) == expected
            fewest.append(int(seeds))
        fewest += [seeds for seeds, _ in agents_of(cell.replace("fixed", "randomized")).values()]
    assert f"With {NUMBERS[min(fewest) - 4]} seeds or more, no effect" in readme
    claims = re.findall(r"^\| .+ \| .+ \| .+ \| (.+) \|$", PAGE.read_text("utf-8"), re.M)[1:7]
    assert all(verdict.startswith("not found") for verdict in claims), claims
