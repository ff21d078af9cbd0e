"""The section on single changes of A3C: its sentences follow from the rows."""

import numpy as np
import pytest

from benchmarks.a3c_changes import GROUPS
from scripts.answer_changes import changes_section, left_out, single_changes, smallest_set

NAMES = ["none", *GROUPS]


def variant(success, returns=(-70.0, -71.0, -69.0)):
    return {"success": np.array(success), "return_mean": np.array(returns)}


def test_changes_that_move_the_return_are_named():
    measured = {name: variant([0.0, 0.01, 0.02]) for name in NAMES}
    measured["pixels"] = variant([0.02, 0.02, 0.02])
    measured["rewards"] = variant([0.0, 0.0, 0.0], (-50.0, -51.0, -49.0))
    measured["entropy"] = variant([0.0, 0.0, 0.0], (-90.0, -91.0, -89.0))
    text = single_changes(measured, 2_000_000)
    assert "with one of 11 changes, the most success has `pixels`, 2.0 %. The return" in text
    assert "higher with `rewards` (+20 [+18, +22]), and lower with `entropy` (-20 [-2" in text
    measured = {name: variant([0.0, 0.0, 0.0]) for name in NAMES}
    text = single_changes(measured, 2_000_000)
    assert "none has a success. " in text
    assert text.endswith("higher with none of them, and lower with none of them.")


def test_changes_with_few_seeds_are_not_compared():
    measured = {name: variant([0.0, 0.0, 0.0]) for name in NAMES}
    measured["rewards"] = variant([0.0], (-10.0,))
    assert "are not compared" in single_changes(measured, 2_000_000)
    assert single_changes({"all": variant([0.5])}, 5_000_000) == ""


def test_the_smallest_set_has_four_fifths_of_the_success_of_all():
    measured = {
        "all": variant([0.5, 0.5, 0.5]),
        "without-pixels": variant([0.6, 0.6, 0.6]),
        "rewards": variant([0.3, 0.3, 0.3]),
        "rewards+entropy": variant([0.9]),  # one seed
        "rewards+batch": variant([0.39, 0.39, 0.39]),
        "rewards+batch+pixels": variant([0.4, 0.41, 0.42]),
        "rewards+batch+pixels+epsilon": variant([0.5, 0.6, 0.7]),
    }
    text = smallest_set(measured, 5_000_000)
    assert text.startswith("After 5 million steps the smallest set")
    assert "has 3: `rewards`, `batch`, `pixels`" in text
    assert smallest_set({**measured, "all": variant([0.5])}, 5_000_000) == ""
    smaller = {name: measured[name] for name in ("all", "rewards")}
    assert smallest_set(smaller, 5_000_000).startswith("No smaller set that three seeds tried")
    assert smallest_set({"all": measured["all"]}, 5_000_000) == ""


def test_changes_left_out_with_one_seed_are_kept_or_dropped():
    measured = {f"without-{name}": variant([0.1], (-50.0,)) for name in GROUPS}
    measured |= {"all": variant([0.5, 0.1, 0.1]), "without-pixels": variant([0.4], (-30.0,))}
    text = left_out(measured, 5_000_000)
    needed = ", ".join(f"`{name}`" for name in GROUPS if name != "pixels")
    assert f"success of all without {needed}, and at least as much without `pixels`." in text
    assert left_out({"all": variant([0.5])}, 5_000_000) == ""


@pytest.mark.parametrize("seeds", [1, 3])
def test_the_section_has_a_table_for_each_number_of_steps(tmp_path, seeds):
    path = tmp_path / "changes.csv"
    lines = ["change,seed,steps,success,accuracy,return_mean,training_success,entropy"]
    for seed in range(seeds):
        lines += [f"{name},{seed},2000000,.01,.2,-70.{seed},0,9.5" for name in NAMES]
    lines.append("all,0,5000000,.475,.5,-30,.4,6")
    path.write_text("\n".join(lines))
    text = "\n\n".join(changes_section(path))
    assert "### After 2 million steps" in text
    assert "| `all` | 1 | 47.5 | -30.0 | 6.0 |" in text
    assert f"| `none` | {seeds} | 1.0" in text
