"""The section on single changes of A3C: its sentences follow from the packs."""

import numpy as np

from benchmarks import a3c_changes
from benchmarks.a3c_changes import GROUPS
from scripts.answer_changes import (
    changes_section,
    left_out,
    single_changes,
    smallest_set,
)
from tests.bench.changes import write_runs

NAMES = ["none", *GROUPS]


def variant(success, returns=(-70.0, -71.0, -69.0)):
    return {"success": np.array(success), "return_mean": np.array(returns)}


def test_changes_that_move_the_return_are_named():
    measured = {name: variant([0.0, 0.01, 0.02]) for name in NAMES}
    measured["pixels"] = variant([0.02, 0.02, 0.02])
    measured["rewards"] = variant([0.0, 0.0, 0.0], (-50.0, -51.0, -49.0))
    measured["entropy"] = variant([0.0, 0.0, 0.0], (-90.0, -91.0, -89.0))
    text = single_changes(measured, 2_000_000)
    assert (
        "with one of 11 changes, the most success has `pixels`, 2.0 %. The return"
        in text
    )
    assert (
        "higher with `rewards` (+20 [+18, +22]), and lower with `entropy` (-20 [-2"
        in text
    )
    measured = {name: variant([0.0, 0.0, 0.0]) for name in NAMES}
    text = single_changes(measured, 2_000_000)
    assert "none has a success. " in text
    assert text.endswith("higher with none of them, and lower with none of them.")
    measured["rewards"] = variant([0.0], (-10.0,))  # one seed
    assert "are not compared" in single_changes(measured, 2_000_000)


def test_the_smallest_set_has_four_fifths_of_the_success_of_all():
    measured = {
        "all": variant([0.5, 0.5, 0.5]),
        "without-pixels": variant([0.6, 0.6, 0.6]),
        "rewards": variant([0.3, 0.3, 0.3]),
        "rewards_entropy": variant([0.9]),  # one seed
        "batch_rewards": variant([0.39, 0.39, 0.39]),
        "batch_rewards_pixels": variant([0.4, 0.41, 0.42]),
        "batch_epsilon_rewards_pixels": variant([0.5, 0.6, 0.7]),
    }
    text = smallest_set(measured, 5_000_000)
    assert text.startswith("After 5 million steps the smallest set")
    assert "has 3: `batch`, `rewards`, `pixels`" in text
    large = {"without-batch": variant([0.5, 0.4, 0.4]), "all": measured["all"]}
    assert "has 10: all but `batch`. Sets" in smallest_set(large, 5_000_000)
    assert smallest_set({**measured, "all": variant([0.5])}, 5_000_000) == ""
    smaller = {name: measured[name] for name in ("all", "rewards")}
    assert smallest_set(smaller, 5_000_000).startswith(
        "No smaller set that three seeds tried"
    )
    assert smallest_set({"all": measured["all"]}, 5_000_000) == ""


def test_changes_left_out_with_one_seed_are_kept_or_dropped():
    measured = {f"without-{name}": variant([0.1], (-50.0,)) for name in GROUPS}
    measured |= {
        "all": variant([0.5, 0.1, 0.1]),
        "without-pixels": variant([0.4], (-30.0,)),
    }
    text = left_out(measured, 5_000_000)
    needed = ", ".join(f"`{name}`" for name in GROUPS if name != "pixels")
    assert (
        f"success of all without {needed}, and at least as much without `pixels`."
        in text
    )
    assert left_out({"all": variant([0.5])}, 5_000_000) == ""


def test_the_section_has_a_table_for_each_number_of_steps(tmp_path):
    runs, packs = tmp_path / "runs", tmp_path / "packs"
    write_runs(runs, 2_000_000, {name: [0.01, 0.01, 0.01] for name in NAMES})
    larger = {
        "all": [0.475] * 3,
        "without-batch": [0.4] * 3,
        "rewards_pixels": [0.1] * 3,
    }
    # Too few for the table
    write_runs(runs, 5_000_000, larger | {"without-pixels": [0.45]})
    a3c_changes.pack(runs, packs)
    text = "\n\n".join(changes_section(packs))
    assert "46 runs" in text
    before, _, after = text.partition("### After 5 million steps")
    assert "### After 2 million steps" in before
    table = [
        line.split("`")[1] for line in after.splitlines() if line.startswith("| `")
    ]
    assert table == ["rewards_pixels", "without-batch", "all"]
    assert "| `all` | 47.5 [47.5, 47.5] | -70.0, -71.0, -72.0 |" in after
