"""Figures of README's table are those of the committed packs."""

import json
import re
import tarfile
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize(
    ("pack", "experiment", "splits"),
    [
        ("answers", "irb120-choose-answers-fast", ("s4", "s3")),
        ("answers", "tiago-choose-answers-fast", ("s4", "s3")),
        ("answers-distil", "irb120-choose-answers-distil", ("s4", "s3")),
        ("answers-distil", "tiago-choose-answers-distil", ("s4", "s3")),
        ("families", "irb120-families-answers-distil", ("s3a", "s3b")),
        ("families", "tiago-families-answers-distil", ("s3a", "s3b")),
    ],
)
def test_figures_are_those_of_the_packs(pack, experiment, splits):
    (row,) = re.findall(
        rf"^\| `{experiment}` \(.*?\).*?\| (.+) \|$", (ROOT / "README.md").read_text(), re.M
    )
    shares = defaultdict(list)
    with tarfile.open(ROOT / "docs/results" / f"{pack}.tar.xz") as file:
        for member in file:
            pattern = rf"{experiment}/\d/evaluation/[a-z-]+-(\w+)/summary"
            if found := re.search(pattern, member.name):
                numbers = json.load(file.extractfile(member))["numbers"]
                for measure in ("choice", "success"):
                    shares[found[1], measure].append(100 * numbers[measure]["estimate"])
    shown = [shares[split, measure] for split in splits for measure in ("choice", "success")]
    assert row == " | ".join(f"{np.mean(each):.1f} %" for each in shown)
    assert {len(each) for each in shown} == {5}
    kinds = {key: np.mean(each) for key, each in shares.items()}
    for measure in ("choice", "success"):  # the first split is among the best, the second the worst
        worst = min(value for (_, name), value in kinds.items() if name == measure)
        assert kinds[splits[1], measure] == worst
