"""Draw and store the suites of the benchmark; a published suite is never written again.

python -m scripts.freeze_suites reach-v1
"""

import json
import sys
from dataclasses import fields, replace
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save

from knowarm.benchmark.suites import (
    FOLDER,
    Cell,
    Split,
    Suite,
    parse_suite,
    read_suite,
)
from knowarm.config import to_dict
from knowarm.experiment.evaluation import EvaluationConfig, SplitTest, Subject
from knowarm.experiment.names import experiment_config
from knowarm.knowledge.formats import read_graph
from knowarm.knowledge.graph.damage import Damage, damaged
from knowarm.world.agents import OpenLoopAgent, OracleAgent
from knowarm.world.agents.open_loop import search_open_loop
from knowarm.world.agents.play import play
from knowarm.world.config import questions_of
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.sampling import Episodes

EPISODES = 500
OPTIONS = {"training_seeds": 5, "control_episodes": 200}
SEED = 7_000_003  # of the episodes; no training and no other evaluation draws from it
REACH = {"fixed": "bm", "randomized": "bm-dr"}
SPLITS: tuple[Split, ...] = ("S1", "S2", "S3", "S4", "S5")


def freeze(
    name: str,
    about: str,
    cells: list[Cell],
    *,
    training_seeds: int,
    control_episodes: int,
) -> Suite:
    """Make a suite of cells."""
    arrays: dict[str, NDArray[Any]] = {}
    described = {}
    queries = np.unique(np.concatenate([cell.episodes.question for cell in cells]))
    for cell in cells:
        for field in fields(Episodes):
            if field.name != "names":  # the config of the cell has them
                arrays[f"{cell.name}/{field.name}"] = getattr(cell.episodes, field.name)
        numbers = np.searchsorted(queries, cell.episodes.question)
        arrays[f"{cell.name}/question"] = numbers.astype(np.int64)
        arrays[f"{cell.name}/open_loop"] = cell.open_loop.astype(np.uint8)
        described[cell.name] = {
            "env": to_dict(cell.env),
            "split": cell.split,
            "reference": cell.reference,
        }
        if cell.graph is not None:
            lines = ["\t".join(triple) for triple in cell.graph]
            described[cell.name]["graph"] = {
                "triples": lines,
                "entities": cell.graph.entities,
            }
    values = {
        "format": 1,
        "name": name,
        "about": about,
        "training_seeds": training_seeds,
        "control_episodes": control_episodes,
        "queries": queries.tolist(),
        "cells": described,
    }
    arrays = {key: np.ascontiguousarray(array) for key, array in arrays.items()}
    return parse_suite((json.dumps(values, indent=1) + "\n").encode(), save(arrays))


def cell(name: str, experiment: str, how: EvaluationConfig) -> Cell:
    """Draw the episodes of a cell, search its fixed list, and let the oracle play."""
    config = how.prepare(Subject(env=experiment_config(experiment).env)).env
    episodes = evaluation_episodes(config, EPISODES, SEED)
    listed = search_open_loop(config)
    env = ArmVectorEnv(config, 100)
    scores = {
        "oracle": float(play(OracleAgent(env), env, episodes).success.mean()),
        "open-loop": float(play(OpenLoopAgent(listed), env, episodes).success.mean()),
        "chance": 1 / config.task.asked.visible if questions_of(config) else None,
    }
    print(name, scores, flush=True)
    return Cell(name, config, how.split, episodes, np.asarray(listed), scores)


def reach() -> Suite:
    """The paper's cells: both robots, fixed and randomized colours."""
    how = EvaluationConfig(distance_m=0.05, angle_deg=15.0)
    cells = [
        cell(f"{robot}-{colours}", f"{robot}-{agent}-fast", how)
        for robot in ("irb120", "tiago")
        for colours, agent in REACH.items()
    ]
    about = "Reach the grasp pose of the visible object, within 5 cm and 15 degrees."
    return freeze("reach-v1", about, cells, **OPTIONS)


def choose() -> Suite:
    """The choose task: both robots, splits S1 to S5."""
    cells = []
    for robot in ("irb120", "tiago"):
        for split in SPLITS:
            how = EvaluationConfig(
                distance_m=0.05, angle_deg=15.0, test=(SplitTest(split=split),)
            )
            cells.append(cell(f"{robot}-{split}", f"{robot}-choose-bm-fast", how))
    about = (
        "Reach the object, of four, that a query describes, within 5 cm and 15 degrees. S1: new "
        "layouts; S2: new pairs of condition and object; S3: new objects; S4: new values; S5: an "
        "edited graph."
    )
    return freeze("choose-v1", about, cells, **OPTIONS)


def damaged_graph() -> Suite:
    """Split S1 of choose-v1, episode for episode, with graphs of which 30 % are damaged."""
    cells, graph = [], read_graph("objects")
    for robot in ("irb120", "tiago"):
        whole = read_suite("choose-v1").cells[f"{robot}-S1"]
        for kind in get_args(Damage):
            broken = damaged(graph, kind, 0.3, SEED, whole.env.targets)
            cells.append(replace(whole, name=f"{robot}-{kind}", graph=broken))
    about = (
        "The episodes of choose-v1's split S1, with a graph of which 30 % of the triples about the "
        "objects are damaged: missing; wrong (another tail of the relation); adversarial (values "
        "swapped in pairs). The undamaged graph judges."
    )
    return freeze("damaged-graph-v1", about, cells, **OPTIONS)


SUITES = {"reach-v1": reach, "choose-v1": choose, "damaged-graph-v1": damaged_graph}

if __name__ == "__main__":
    for name in sys.argv[1:]:
        if (FOLDER / f"{name}.json").exists():
            raise SystemExit(f"{name} is published: make a new version.")
        suite = SUITES[name]()
        for suffix, data in zip((".json", ".safetensors"), suite.data, strict=True):
            (FOLDER / f"{name}{suffix}").write_bytes(data)
        print(suite.name, suite.digest)
