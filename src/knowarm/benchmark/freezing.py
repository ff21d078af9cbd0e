"""Freezing of suites: episodes are drawn and references played once, and stored as data."""

import json
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors.numpy import save

from knowarm.arrays import Integers
from knowarm.benchmark.suites import FILE, Cell, Suite, input_digest, parse_suite
from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.experiment.evaluation import EvaluationConfig, Subject
from knowarm.experiment.run_inputs import copy_input, with_inputs
from knowarm.reading import writing
from knowarm.world.agents import OpenLoopAgent, OracleAgent
from knowarm.world.agents.open_loop import search_open_loop
from knowarm.world.agents.play import play
from knowarm.world.config import EnvConfig, questions_of
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.sampling import Episodes

EPISODES = 500
SEED = 7_000_003  # of the episodes; no training and no other evaluation draws from it


def freeze_cell(
    name: str,
    env: EnvConfig,
    how: EvaluationConfig,
    episodes: int = EPISODES,
    report: Callable[[str], None] = lambda line: None,
    listed: Integers | None = None,
) -> Cell:
    """Draw the episodes of a cell, search its fixed list, and let the oracle play.

    Args:
        name: of the cell.
        env: robot, task and objects.
        how: thresholds, and the split of the questions.
        episodes: number of episodes.
        report: receives a line with the scores of references.
        listed: the fixed list of actions of a cell alike, which is then not searched.
    """
    config = how.prepare(Subject(env=env)).env
    drawn = evaluation_episodes(config, episodes, SEED)
    unseen = replace(config, image_size=8)  # neither reference reads an image
    if listed is None:
        listed = search_open_loop(unseen)
    played = ArmVectorEnv(unseen, min(100, episodes))
    chance = None
    if questions_of(config) is not None:
        chance = 1 / config.task.asked.visible
    scores = {
        "oracle": float(play(OracleAgent(played), played, drawn).success.mean()),
        "open-loop": float(play(OpenLoopAgent(listed), played, drawn).success.mean()),
        "chance": chance,
    }
    report(f"{name}: {scores}")
    return Cell(name, config, how.split, drawn, np.asarray(listed), scores)


def freeze(
    name: str,
    about: str,
    cells: Sequence[Cell],
    *,
    training_seeds: int = 5,
    control_episodes: int = 200,
    stored: Callable[[str], str] = str,
    folder: Path | None = None,
) -> Suite:
    """Make a suite of cells; ``stored`` names each file of the user in the suite's folder."""
    arrays: dict[str, NDArray[Any]] = {}
    described = {}
    queries = np.unique(np.concatenate([cell.episodes.question for cell in cells]))
    for cell in cells:
        for field in fields(Episodes):
            values = getattr(cell.episodes, field.name)
            is_drawn = field.name != "surroundings" or values.size > 0
            if field.name != "names" and is_drawn:  # the config of the cell has them
                arrays[f"{cell.name}/{field.name}"] = values
        numbers = np.searchsorted(queries, cell.episodes.question)
        arrays[f"{cell.name}/question"] = numbers.astype(np.int64)
        arrays[f"{cell.name}/open_loop"] = cell.open_loop.astype(np.uint8)
        described[cell.name] = {
            "env": with_inputs(to_dict(cell.env), stored),
            "split": cell.split,
            "reference": cell.reference,
        }
        if cell.group:
            described[cell.name]["group"] = cell.group
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
    text = (json.dumps(values, indent=1) + "\n").encode()
    return parse_suite(text, save(arrays), folder)


def write_suite(
    folder: Path, about: str, cells: Sequence[Cell], **options: Any
) -> Suite:
    """Store a suite of one's own in a folder, with copies of all files that its tasks name.

    Raises:
        UserError: the folder exists: a suite is never written again.
    """
    if folder.exists():
        raise UserError(
            f"{folder} exists, and a suite is never written again. Give another folder."
        )

    def stored(name: str) -> str:
        number = input_digest(name)
        copy_input(name, folder / "inputs" / number / Path(name).name)
        return f"inputs/{number}/{Path(name).name}"

    with writing(folder):
        (folder / "inputs").mkdir(parents=True)
        suite = freeze(
            folder.name, about, cells, stored=stored, folder=folder, **options
        )
        for suffix, data in zip((".json", ".safetensors"), suite.data, strict=True):
            (folder / f"{FILE}{suffix}").write_bytes(data)
    return suite
