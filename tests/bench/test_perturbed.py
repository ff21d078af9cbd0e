"""What is off in `benchmarks.perturbed`, and its table on the page of the answers."""

import csv
import re
from math import sqrt
from pathlib import Path

import numpy as np
import pytest

from benchmarks.perturbed import CELLS, Delayed, Miscalibrated, read_rows, rows, table
from knowarm.world.agents import Batch
from knowarm.world.config import EnvConfig

RESULTS = Path(__file__).parents[2] / "docs" / "results"
CSV = RESULTS / "perturbed.csv"


class Noted:
    """Keeps what it is reset with and what it observes."""

    def reset(self, batch):
        self.batch = batch
        self.seen = []

    def act(self, observations):
        self.seen.append(observations)
        return np.zeros((self.batch.size, 2), np.int64)


def batch():
    joints = {"a": np.array([0.1, 0.2]), "b": np.array([0.3, 0.4])}
    return Batch(env=EnvConfig(), names=np.array(["mug/red", "mug/red"]), joints=joints)


def observed(step):
    images = np.full((2, 4, 4, 3), step, np.uint8)
    targets = np.full((2, 2), float(step), np.float32)
    return {"image": images, "joint_targets": targets}


def test_images_are_as_many_steps_old():
    agent = Noted()
    late = Delayed(agent, 2)
    for _ in range(2):  # nothing is left of the episodes before
        late.reset(batch())
        for step in range(5):
            late.act(observed(step))
        images = [int(each["image"].max()) for each in agent.seen]
        assert images == [0, 0, 0, 1, 2]
        assert [each["joint_targets"][0, 0] for each in agent.seen] == [0, 1, 2, 3, 4]


def test_joints_are_off_by_the_amount_in_the_start_and_in_every_step():
    agent = Noted()
    off = Miscalibrated(agent, 2)
    off.reset(batch())
    started = np.stack(list(agent.batch.joints.values()), 1)
    true = np.stack(list(batch().joints.values()), 1)
    assert np.abs(started - true) == pytest.approx(np.deg2rad(2))
    off.act(observed(1))
    off.act(observed(2))
    for step, each in enumerate(agent.seen, 1):
        assert each["joint_targets"] - step == pytest.approx(started - true, abs=1e-6)
    assert np.array_equal(agent.seen[0]["image"], observed(1)["image"])


def wilson(hits, count):
    """Return a share with Wilson's interval in percent, by the formula."""
    z, share = 1.959963984540054, hits / count
    middle, half = (
        share + z * z / (2 * count),
        z * sqrt(share * (1 - share) / count + z * z / (4 * count * count)),
    )
    ends = [100 * (middle + sign * half) / (1 + z * z / count) for sign in (-1, 1)]
    return [100 * share, *ends]


def test_the_table_of_the_page_is_that_of_the_file():
    with CSV.open(encoding="utf-8", newline="") as file:
        lines = list(csv.DictReader(file))
    text = table(read_rows(CSV))
    assert text in (RESULTS / "answers.md").read_text("utf-8")
    heads = text.splitlines()[0].split(" | ")
    for line in lines:
        what = "nothing"
        if line["off"] != "nothing":
            kind, unit = re.fullmatch(r"(\w+) \[(\w+)\]", line["off"]).groups()
            what = f"{kind}, {float(line['amount']):g} {unit}"
        (row,) = re.findall(rf"^\| {what} \|.+\|$", text, re.M)
        (column,) = (
            number
            for number, head in enumerate(heads)
            if f"`{line['run']}`, {line['agent']}" in head
        )
        cell = row.split(" | ")[column]
        printed = [float(number) for number in re.findall(r"[\d.]+", cell)]
        count = int(line["episodes"])
        success, right = (
            100 * int(line[name]) / count for name in ("success", "right")
        )
        assert printed == pytest.approx([success, right], abs=0.051)
        middle, low, high = wilson(int(line["success"]), count)
        assert max(middle - low, high - middle) < 7


def test_a_row_that_nobody_played_yet_is_empty_and_one_without_effect_says_so():
    line = {"run": "r", "agent": "seen", "off": "joints [deg]", "amount": "2"}
    counts = {"episodes": "10", "right": "9", "success": "5"}
    assert "| joints, 2 deg | = | 50.0 (90.0) |" in table([line | counts])
    line |= {"off": "camera [cm]"}
    assert "| camera, 2 cm |  | 50.0 (90.0) |" in table([line | counts])


def test_every_amount_is_played_once_per_agent():
    assert len(set(rows())) == sum(len(who) for _, _, who in CELLS) == 20
