"""A policy and "see, then solve" on the same network where camera, joint angles or images are off.

    python -m benchmarks.perturbed RUN... [--episodes 200] --csv FILE
    python -m benchmarks.perturbed --csv FILE      # prints the table of the file

Camera: shifted along, or turned about, each of its axes by a uniform draw per episode, up to the
amount, which is also the root mean square over three axes. Joints: what the inverse kinematics take
for each joint's angle is off by the amount, with a sign drawn per joint and episode; a policy reads
no joint angles. Delay: images are as many steps old; who solves reads the first one only. Starts,
objects and questions are the same in every row. Rows that stand in the file are not played again.
"""

import argparse
import csv
import sys
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from knowarm.arrays import Integers
from knowarm.experiment.evaluation import EvaluationConfig, SplitTest, Subject
from knowarm.experiment.load import TrainedAgent, load_agent
from knowarm.perception.solving import SolvingAgent
from knowarm.world.agents.play import EpisodeResults, play
from knowarm.world.agents.protocol import AgentProtocol, Batch, Observations
from knowarm.world.agents.scripted import InformedAgent
from knowarm.world.config import EnvConfig, facets_of
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.scene.appearance import VisualRandomization

SEED = 7_000_003  # of the frozen suites
COLUMNS = ("run", "agent", "off", "amount", "episodes", "right", "success")
BOTH = ("policy", "seen")
CELLS: list[tuple[str, float, tuple[str, ...]]] = [
    ("nothing", 0, BOTH),
    ("camera [cm]", 2, BOTH),
    ("camera [deg]", 2, BOTH),
    ("joints [deg]", 2, ("seen",)),
    ("joints [deg]", 1, ("seen",)),
    ("images [steps]", 2, ("policy",)),
    ("images [steps]", 4, ("policy",)),
    ("camera [cm]", 4, BOTH),
    ("camera [deg]", 4, BOTH),
    ("camera [cm]", 1, BOTH),
    ("camera [deg]", 1, BOTH),
    ("joints [deg]", 0.5, ("seen",)),
    ("images [steps]", 1, ("policy",)),
]
"""What is off, by how much, and who is affected, in the order in which it is played."""


class Miscalibrated(InformedAgent):
    """Plays an agent that takes every joint angle for another by a fixed amount [deg]."""

    def __init__(self, agent: AgentProtocol, amount: float) -> None:
        super().__init__(agent, self._shifted)
        self._amount = np.deg2rad(amount)
        self._generator = np.random.default_rng(SEED)

    def _shifted(self, batch: Batch) -> Batch:
        shape = (batch.size, len(batch.joints))
        signs = self._generator.choice([-1.0, 1.0], shape)
        self._offset = self._amount * signs
        joints = {}
        for number, (name, angle) in enumerate(batch.joints.items()):
            joints[name] = angle + self._offset[:, number]
        return replace(batch, joints=joints)

    def act(self, observations: Observations) -> Integers:
        """Choose actions by joint targets that are as far off."""
        targets = observations["joint_targets"] + self._offset
        return super().act({**observations, "joint_targets": targets})


class Delayed(InformedAgent):
    """Plays an agent whose images are some steps old; the first is seen until then."""

    def __init__(self, agent: AgentProtocol, amount: float) -> None:
        super().__init__(agent)
        self._kept = int(amount) + 1

    def reset(self, batch: Batch) -> None:
        """Forget the images."""
        super().reset(batch)
        self._images: deque[np.ndarray] = deque(maxlen=self._kept)

    def act(self, observations: Observations) -> Integers:
        """Choose actions by the oldest image that is kept."""
        self._images.append(observations["image"].copy())
        return super().act({**observations, "image": self._images[0]})


WRAPPERS: dict[str, Callable[[AgentProtocol, float], Any]] = {
    "joints [deg]": Miscalibrated,
    "images [steps]": Delayed,
}


def made(trained: TrainedAgent, env: EnvConfig, who: str) -> AgentProtocol:
    """Return the policy, or what solves with its network."""
    if who == "policy":
        return trained.agent
    return SolvingAgent(
        trained.agent, env, env.task.asked.answering_graph(facets_of(env))
    )


def played(
    trained: TrainedAgent, who: str, off: str, amount: float, episodes: int
) -> EpisodeResults:
    """Play the episodes of a row."""
    how = EvaluationConfig(
        test=(SplitTest(split="S1"),), distance_m=0.05, angle_deg=15.0
    )
    env = how.prepare(Subject(env=trained.config.env, config=trained.config)).env
    same = evaluation_episodes(env, episodes, SEED)
    if off.startswith("camera"):
        varied = VisualRandomization(camera_turn_deg=amount)
        if off == "camera [cm]":
            varied = VisualRandomization(camera_shift_m=amount / 100)
        env = replace(env, randomization=varied)
        look = evaluation_episodes(env, episodes, SEED).look
        same = replace(same, look=look)
    agent = made(trained, env, who)
    if off in WRAPPERS:
        agent = WRAPPERS[off](agent, amount)
    played_in = ArmVectorEnv(env, min(100, episodes), num_threads=1)
    result = play(agent, played_in, same)
    played_in.close()
    return result


def rows() -> Iterator[tuple[str, float, str]]:
    """Yield what is off, by how much, and who acts, row by row."""
    for off, amount, affected in CELLS:
        for who in affected:
            yield off, amount, who


def read_rows(path: Path) -> list[dict[str, str]]:
    """Return the rows of a file; none where there is no file."""
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def table(lines: list[dict[str, str]]) -> str:
    """Return success (right choices) in percent, by what is off and who acts in which run."""
    cells: dict[tuple[str, float], dict[tuple[str, str], str]] = {}
    for line in lines:
        count = int(line["episodes"])
        success = 100 * int(line["success"]) / count
        right = 100 * int(line["right"]) / count
        row = cells.setdefault((line["off"], float(line["amount"])), {})
        row[line["run"], line["agent"]] = f"{success:.1f} ({right:.1f})"
    runs = sorted({line["run"] for line in lines})
    columns = list(product(runs, BOTH))
    heads = "".join(f" `{run}`, {who} |" for run, who in columns)
    parts = [f"| off |{heads}\n|---|{'---|' * len(columns)}"]
    order = list(dict.fromkeys(off for off, _, _ in CELLS))
    for off, amount in sorted(cells, key=lambda key: (order.index(key[0]), key[1])):
        kind, _, unit = off.partition(" ")
        what = f"{kind}, {amount:g} {unit.strip('[]')}" if amount else kind
        affected = next(who for name, _, who in CELLS if name == off)
        texts = [what]
        for run, who in columns:
            missing = "" if who in affected else "="
            texts.append(cells[off, amount].get((run, who), missing))
        parts.append(f"| {' | '.join(texts)} |")
    return "\n".join(parts)


def main() -> None:
    """Play the rows that the file lacks, and append them; without runs, print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", type=Path, nargs="*")
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--csv", type=Path, required=True)
    given = parser.parse_args()
    if not given.runs:
        print(table(read_rows(given.csv)))
        return
    done = set()
    for row in read_rows(given.csv):
        done.add((row["run"], row["agent"], row["off"], float(row["amount"])))
    if not done:
        given.csv.write_text(",".join(COLUMNS) + "\n", encoding="utf-8")
    for run, (off, amount, who) in product(given.runs, rows()):
        name = run.name if run.parent.name == "zoo" else f"{run.parent.name}/{run.name}"
        if (name, who, off, float(amount)) in done:
            continue
        result = played(load_agent(run), who, off, amount, given.episodes)
        right = int(result.infos["is_right_object"].sum())
        counts = (len(result.length), right, int(result.success.sum()))
        values = [name, who, off, amount, *counts]
        with given.csv.open("a", encoding="utf-8", newline="") as file:
            csv.writer(file, lineterminator="\n").writerow(values)
        print(*values, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
