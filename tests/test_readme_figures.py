"""Figures of README's table are those of the committed packs."""

import json
import re
import tarfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize(
    ("pack", "experiment", "split", "measure"),
    [
        ("answers", "irb120-choose-answers-fast", "s4", "choice"),
        ("answers", "tiago-choose-answers-fast", "s4", "choice"),
        ("answers-distil", "irb120-choose-answers-distil", "s4", "success"),
        ("answers-distil", "tiago-choose-answers-distil", "s4", "success"),
        ("families", "irb120-families-answers-distil", "s3a", "success"),
        ("families", "tiago-families-answers-distil", "s3a", "success"),
    ],
)
def test_figures_are_those_of_the_packs(pack, experiment, split, measure):
    (row,) = re.findall(
        rf"^\| `{experiment}`.*\| (.+) % \|$", (ROOT / "README.md").read_text(), re.M
    )
    shares = {}
    with tarfile.open(ROOT / "docs/results" / f"{pack}.tar.xz") as file:
        for member in file:
            found = re.search(rf"{experiment}/(\d)/evaluation/[a-z-]+-{split}/summary", member.name)
            if found:
                shares[found[1]] = (
                    100 * json.load(file.extractfile(member))["numbers"][measure]["estimate"]
                )
    assert row == ", ".join(f"{shares[seed]:.1f}" for seed in sorted(shares))
    assert len(shares) == 5
