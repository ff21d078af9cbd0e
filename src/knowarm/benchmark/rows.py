"""Rows of the benchmark: play a suite, store every episode's outcome, verify a stored row."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import knowarm
from knowarm.benchmark.policies import Entrant
from knowarm.benchmark.suites import CONTROLS, Cell, Suite, read_suite
from knowarm.config import differences
from knowarm.errors import UserError, unknown_name
from knowarm.reading import read_json
from knowarm.statistics import Interval, bootstrap, wilson
from knowarm.world.agents.play import play
from knowarm.world.agents.protocol import INPUTS, AgentProtocol, Batch
from knowarm.world.agents.scripted import BlindAgent, FrozenAgent, InformedAgent, OpenLoopAgent
from knowarm.world.config import questions_of
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.sampling import Episodes

FORMAT = 2
MOST_TEXT = 300
"""Longest text of a row: a name, a spec, or how a policy was trained."""
MOST_TOLERANCE = 0.1
FIELDS = {"format", "suite", "digest", "name", "policy", "version", "cells", "summary"}
OWN_CONTROL = "shuffled graph"  # of agents that answer by a graph, and of no others
Bits = NDArray[np.bool_]


def run_suite(
    suite: Suite,
    entrants: Sequence[Entrant],
    *,
    name: str,
    cells: Sequence[str] = (),
    report: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Play a suite with the training seeds of a policy; return a row.

    Args:
        suite: what to play.
        entrants: the policy, one per training seed.
        name: of the row in tables.
        cells: names, or beginnings of names, of the cells to play; none plays all.
        report: called with a line per cell and seed.

    Raises:
        UserError: an unknown cell, or a policy that cannot play one.
    """
    for wanted in cells:
        if not any(each.startswith(wanted) for each in suite.cells):
            raise unknown_name("cell", wanted, suite.cells)
    chosen = [
        cell
        for cell in suite.cells.values()
        if not cells or any(cell.name.startswith(each) for each in cells)
    ]
    _check_seeds(entrants)
    _check_cells(entrants, chosen)
    played: dict[str, list[dict[str, Any]]] = {cell.name: [] for cell in chosen}
    for entrant in entrants:
        for cell in chosen:
            outcome = _play_cell(suite, cell, entrant)
            played[cell.name].append(outcome)
            solved = _outcomes(outcome["policy"]["success"]).sum()
            report(f"{cell.name}: {entrant.spec} succeeds in {solved:,} episodes")
    row = {
        "format": FORMAT,
        "suite": suite.name,
        "digest": suite.digest,
        "name": name,
        "policy": {"specs": [each.spec for each in entrants], **_declared(entrants)},
        "version": knowarm.__version__,
        "cells": {name: {"outcomes": outcomes} for name, outcomes in played.items()},
    }
    return row | _figures(suite, row)


def _declared(entrants: Sequence[Entrant]) -> dict[str, Any]:
    """Return what a row says about a policy, besides where it is."""
    return {
        "digests": [each.digest for each in entrants],
        "seeds": [each.seed for each in entrants],
        "inputs": list(entrants[0].inputs),
        "training": entrants[0].training,
    }


def _check_seeds(entrants: Sequence[Entrant]) -> None:
    """Check that the policies of a row are different training seeds of one policy."""
    for name in ("inputs", "training"):
        if len(found := dict.fromkeys(getattr(each, name) for each in entrants)) > 1:
            given = " | ".join(map(str, found))
            raise UserError(f"The seeds of one policy must have equal {name}, got {given}.")
    different = {each.digest or f"{each.spec}/{each.seed}" for each in entrants}
    if len(different) < len(entrants):
        raise UserError(f"Give each seed once, got {', '.join(each.spec for each in entrants)}.")


def _check_cells(entrants: Sequence[Entrant], cells: Sequence[Cell]) -> None:
    """Check that every policy can play every cell, before the first is played."""
    for cell in cells:
        env = ArmVectorEnv(cell.env, 1)
        try:
            for entrant in entrants:
                entrant.make(cell, env)
        finally:
            env.close()


def _play_cell(suite: Suite, cell: Cell, entrant: Entrant) -> dict[str, Any]:
    """Play one cell with one seed of a policy and with its controls; return outcomes as hex."""
    env = ArmVectorEnv(cell.env, min(entrant.num_envs, len(cell.episodes)))
    try:
        outcome = {"policy": _bits(entrant.make(cell, env), env, cell.episodes)}
        few = cell.episodes[: suite.control_episodes]
        for name, agent in _controls(cell, entrant, env).items():
            outcome[name] = _bits(agent, env, few)
    finally:
        env.close()
    return outcome


def _required(cell: Cell, inputs: Sequence[str]) -> list[str]:
    """Name the controls of every policy that has these inputs."""
    asks = questions_of(cell.env) is not None and not {"words", "graph"}.isdisjoint(inputs)
    found = ["open-loop", *["black", "frozen"] * ("image" in inputs), *["shuffled query"] * asks]
    return found + ["intact graph"] * (cell.graph is not None and "graph" in inputs)


def _controls(cell: Cell, entrant: Entrant, env: ArmVectorEnv) -> dict[str, AgentProtocol]:
    make = entrant.make
    makers: dict[str, Callable[[], AgentProtocol]] = {
        "open-loop": lambda: OpenLoopAgent(cell.open_loop),
        "black": lambda: BlindAgent(make(cell, env)),
        "frozen": lambda: FrozenAgent(make(cell, env)),
        "shuffled query": lambda: InformedAgent(make(cell, env), shuffled),
        "intact graph": lambda: make(replace(cell, graph=None), env),
    }
    agents = {name: makers[name]() for name in _required(cell, entrant.inputs)}
    return agents | {name: make(cell, env) for name, make in entrant.controls.items()}


def shuffled(batch: Batch) -> Batch:
    """Return a batch with the queries of other episodes."""
    return replace(batch, names=batch.names[np.random.default_rng(0).permutation(batch.size)])


def _bits(agent: AgentProtocol, env: ArmVectorEnv, episodes: Episodes) -> dict[str, str]:
    """Play episodes; return success, and where the task has queries right choices, as hex."""
    result = play(agent, env, episodes)
    found = {"success": result.success}
    if "is_right_object" in result.infos:
        found["right"] = result.infos["is_right_object"].astype(bool)
    return {name: np.packbits(bits).tobytes().hex() for name, bits in found.items()}


def _outcomes(text: str, count: int | None = None) -> Bits:
    data = np.frombuffer(bytes.fromhex(text), np.uint8)
    if count is not None and len(data) != -(-count // 8):
        raise ValueError(f"outcomes of {8 * len(data)} instead of {count} episodes")
    return np.unpackbits(data)[:count].astype(bool)


def _figures(suite: Suite, row: dict[str, Any]) -> dict[str, Any]:
    """Compute the figures of every cell, and their means by table, from the episodes' outcomes."""
    cells: dict[str, Any] = {}
    successes: dict[str, list[Bits]] = {}
    for name, cell in row["cells"].items():
        count = len(suite.cells[name].episodes)
        measures: dict[str, Any] = {}
        for measure in cell["outcomes"][0]["policy"]:
            shares = [_outcomes(o["policy"][measure], count) for o in cell["outcomes"]]
            measures[measure] = _share(shares, count)
            if measure == "success":
                successes[name] = shares
        few = min(suite.control_episodes, count)
        controls = {
            control: float(
                np.mean([_outcomes(o[control]["success"], few).mean() for o in cell["outcomes"]])
            )
            for control in CONTROLS
            if control in cell["outcomes"][0]
        }
        cells[name] = {**measures, "controls": controls, "outcomes": cell["outcomes"]}
    summary = {}
    for table in dict.fromkeys(suite.cells[name].table for name in cells):
        names = [name for name in cells if suite.cells[name].table == table]
        by_seed = zip(row["policy"]["specs"], *(successes[n] for n in names), strict=True)
        controls = {
            control: float(np.mean([cells[name]["controls"][control] for name in names]))
            for control in CONTROLS
            if all(control in cells[name]["controls"] for name in names)
        }
        few = min(len(suite.cells[name].episodes) for name in names)
        success = _share([np.concatenate(each) for _, *each in by_seed], few)
        summary[table] = {"cells": names, "success": success, "controls": controls}
    return {"cells": cells, "summary": summary}


def _share(seeds: Sequence[Bits], episodes: int) -> dict[str, Any]:
    """Return a share with its interval, over training seeds if they differ, else over episodes.

    Args:
        seeds: outcomes of each training seed. Seeds that end every episode in the same way count as
            one: they may be one policy, given twice.
        episodes: how many of a seed's outcomes are independent. Cells of a table share starts, and
            so do training seeds.
    """
    shares = [float(each.mean()) for each in seeds]
    different = list({each.tobytes(): each for each in seeds}.values())
    if len({each.mean() for each in different}) > 1:
        found = bootstrap(np.array([each.mean() for each in different]))
    else:
        found = replace(wilson(round(shares[0] * episodes), episodes), estimate=shares[0])
    return {"mean": found.estimate, "low": found.low, "high": found.high, "seeds": shares}


def binding(suite: Suite, row: dict[str, Any], names: Sequence[str]) -> Interval | None:
    """Return how many more choices in cells are right with the own query than with another's.

    The interval is over training seeds if they differ, else over episodes; None without queries.
    """

    def gain(outcome: dict[str, Any], name: str) -> NDArray[np.float64]:
        few = min(suite.control_episodes, len(suite.cells[name].episodes))
        own, other = (
            _outcomes(outcome[who]["right"], None)[:few] for who in ("policy", "shuffled query")
        )
        return own.astype(float) - other

    outcomes = [row["cells"][name]["outcomes"] for name in names]
    if not all("right" in each.get("shuffled query", {}) for each in outcomes[0]):
        return None
    seeds = [
        np.concatenate([gain(outcome, name) for outcome, name in zip(each, names, strict=True)])
        for each in zip(*outcomes, strict=True)
    ]
    means = np.array([each.mean() for each in seeds])
    return bootstrap(means if len({*means}) > 1 else seeds[0], repetitions=2_000)


def read_row(path: Path) -> dict[str, Any]:
    """Read a row, and compare every figure with the outcomes that it follows from.

    Raises:
        UserError: the file is no row, belongs to another suite, or holds a figure that does not
            follow from its episodes; the message names it.
    """
    row = read_json(path)
    if type(row.get("format")) is not int or row["format"] != FORMAT:
        raise UserError(
            f"{path} is no row of this version's benchmark (format {FORMAT}). Measure it again: "
            "knowarm benchmark run."
        )
    suite = read_suite(str(row.get("suite")))
    if row.get("digest") != suite.digest:
        raise UserError(f"{path} was measured on another {suite.name}: the digests differ.")
    try:
        _check_declared(suite, row)
        computed = row | _figures(suite, row)
    except (AttributeError, KeyError, ValueError, TypeError, IndexError) as error:
        raise UserError(f"{path} is damaged: {error!r}. Measure the row again.") from None
    for where, (stored, follows) in differences(row, json.loads(json.dumps(computed))).items():
        raise UserError(f"{path}: {where} is {stored}, but its episodes give {follows}.")
    return row


def _check_declared(suite: Suite, row: dict[str, Any]) -> None:
    """Check the declarations of a row, and that every seed has every control.

    Raises:
        ValueError, TypeError, KeyError: what is wrong.
    """
    said = row["policy"]
    for text in (row["name"], said["training"], *said["inputs"], *said["specs"], *said["digests"]):
        if not text.isprintable() or len(text) > MOST_TEXT:
            raise ValueError(f"{text!r:.40} is not one line of at most {MOST_TEXT} characters")
    if not row["name"] or not row["cells"] or not said["specs"]:
        raise ValueError("it has no name, no cells or no policy")
    if other := row.keys() ^ FIELDS:
        raise ValueError(f"it lacks, or has, {', '.join(sorted(other))}")
    if unknown := set(said["inputs"]) - set(INPUTS):
        raise ValueError(f"policy.inputs names {', '.join(unknown)}")
    for name in ("seeds", "digests"):
        if len(said[name]) != len(said["specs"]):
            raise ValueError(f"policy.{name} and policy.specs differ in length")
    if len(stated := [each for each in said["digests"] if each]) > len({*stated}):
        raise ValueError("policy.digests names one policy twice")
    for name, cell in row["cells"].items():
        needed = {"policy", *_required(suite.cells[name], said["inputs"])}
        for seed in zip(said["specs"], cell["outcomes"], strict=True):
            if wrong := needed ^ (seed[1].keys() - {OWN_CONTROL}):
                raise ValueError(f"cells.{name}.outcomes lacks, or has, {', '.join(sorted(wrong))}")


def verify(
    row: dict[str, Any],
    entrants: Sequence[Entrant],
    *,
    tolerance: float = 0.0,
    report: Callable[[str], None] = lambda line: None,
) -> None:
    """Play a row again and compare every episode.

    Args:
        row: of `read_row`.
        entrants: the policy, one per training seed.
        tolerance: largest share of the episodes of a cell that may end otherwise, for machines
            that round differently.
        report: called with a line per cell and seed.

    Raises:
        UserError: a declaration or a cell differs; the message names it with both values. Digests
            of files may differ where there is a tolerance.
    """
    if not 0 <= tolerance < MOST_TOLERANCE:  # also for NaN
        raise UserError(f"tolerance must lie from 0 to below {MOST_TOLERANCE}, got {tolerance}.")
    suite = read_suite(row["suite"])
    stored, given = row["policy"] | {"specs": []}, {"specs": [], **_declared(entrants)}
    stored |= {"digests": given["digests"]} if tolerance else {}
    for name, (said, found) in differences(stored, given).items():
        raise UserError(f"policy.{name}: the row says {said}, the given policy has {found}.")
    options: dict[str, Any] = {"name": row["name"], "cells": list(row["cells"]), "report": report}
    again = run_suite(suite, entrants, **options)
    for name, cell in row["cells"].items():
        count = len(suite.cells[name].episodes)
        for seed, pair in enumerate(
            zip(cell["outcomes"], again["cells"][name]["outcomes"], strict=True)
        ):
            if other := pair[0].keys() ^ pair[1].keys():
                raise UserError(
                    f"cells.{name}.outcomes[{seed}]: the row and this policy do not have the same "
                    f"controls ({', '.join(sorted(other))})."
                )
            for who in pair[0]:
                few = count if who == "policy" else min(count, suite.control_episodes)
                for measure in pair[0][who]:
                    old, new = (_outcomes(each[who][measure], few) for each in pair)
                    if (old != new).mean() > tolerance:
                        raise UserError(
                            f"cells.{name}.outcomes[{seed}].{who}.{measure}: the row says "
                            f"{old.sum()} of {few} episodes, playing gives {new.sum()}; "
                            f"{(old != new).sum()} episodes end otherwise."
                        )
