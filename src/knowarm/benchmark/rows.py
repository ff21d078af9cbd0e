"""Rows of the benchmark: play a suite, store every episode's outcome, verify a stored row."""

import json
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import knowarm
from knowarm.arrays import Mask
from knowarm.benchmark.policies import Entrant
from knowarm.benchmark.suites import CONTROLS, Cell, Suite, by_table, read_suite
from knowarm.config import differences
from knowarm.errors import Argument, UserError, unknown_name
from knowarm.reading import read_json
from knowarm.statistics import Interval, bootstrap, wilson
from knowarm.world.agents.play import play
from knowarm.world.agents.protocol import INPUTS, AgentProtocol, Batch
from knowarm.world.agents.scripted import (
    BlindAgent,
    FrozenAgent,
    InformedAgent,
    OpenLoopAgent,
)
from knowarm.world.config import questions_of
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.sampling import Episodes

FORMAT = 2
MOST_TEXT = 300
"""Longest text of a row: a name, a spec, or how a policy was trained."""
MOST_TOLERANCE = 0.1
FIELDS = {"format", "suite", "digest", "name", "policy", "version", "cells", "summary"}
OPTIONAL_FIELD = "mujoco"  # version; the first rows lack it
OPTIONAL_CONTROLS = frozenset(
    ("shuffled graph", "shuffled places", "shuffled both", "unknown places")
)
"""Those of agents that answer by a graph, and of no others."""

Row = dict[str, Any]
"""A row, or a part of it."""
Entrants = Sequence[Entrant]
Report = Callable[[str], None]
Outcome = dict[str, dict[str, str]]
"""What one seed did in one cell: for the policy and each control the measures' bits as hex."""


def run_suite(
    suite: Suite,
    entrants: Entrants,
    *,
    name: str,
    cells: Sequence[str] = (),
    report: Report = lambda line: None,
) -> Row:
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
    chosen = _chosen_cells(suite, cells)
    _check_seeds(entrants)
    _check_fits(suite, chosen, entrants)
    played: dict[str, Row] = {cell.name: {"outcomes": []} for cell in chosen}
    for entrant in entrants:
        for cell in chosen:
            outcome = _play_cell(suite, cell, entrant)
            played[cell.name]["outcomes"].append(outcome)
            solved = _bits(outcome["policy"]["success"]).sum()
            report(f"{cell.name}: {entrant.spec} succeeds in {solved:,} episodes")
    row = {
        "format": FORMAT,
        "suite": suite.name,
        "digest": suite.digest,
        "name": name,
        "policy": _declared(entrants),
        "version": knowarm.__version__,
        "mujoco": version("mujoco"),
        "cells": played,
    }
    return row | _figures(suite, row)


def _chosen_cells(suite: Suite, beginnings: Sequence[str]) -> list[Cell]:
    for beginning in beginnings:
        if not any(name.startswith(beginning) for name in suite.cells):
            raise unknown_name("cell", beginning, suite.cells)
    everything = ("",)
    accepted = tuple(beginnings) or everything
    return [cell for name, cell in suite.cells.items() if name.startswith(accepted)]


def _check_fits(suite: Suite, chosen: Sequence[Cell], entrants: Entrants) -> None:
    """Check that policies can play all chosen cells, before the first is played.

    Raises:
        UserError: they cannot; it names the cells of the suite that fit.
    """
    refusals: dict[str, str] = {}
    for cell in suite.cells.values():
        with closing(ArmVectorEnv(cell.env, 1)) as env:
            try:
                for entrant in entrants:
                    entrant.make(cell, env)
            except UserError as error:
                refusals[cell.name] = str(error)
    refused = [cell.name for cell in chosen if cell.name in refusals]
    if not refused:
        return
    name = refused[0]
    fitting = [cell for cell in suite.cells if cell not in refusals]
    reason = f"{name} of {suite.name} cannot be played: {refusals[name]} "
    if not fitting:
        raise UserError(f"{reason}No cell of this suite fits; show names other suites.")
    raise UserError(
        f"{reason}Cells that fit: {', '.join(fitting)}. Play one with ",
        Argument("cells", fitting[0]),
        ".",
    )


def _declared(entrants: Entrants) -> Row:
    """Return what a row says about a policy."""
    first = entrants[0]
    return {
        "specs": [entrant.spec for entrant in entrants],
        "digests": [entrant.digest for entrant in entrants],
        "seeds": [entrant.seed for entrant in entrants],
        "inputs": list(first.inputs),
        "training": first.training,
    }


def _check_seeds(entrants: Entrants) -> None:
    """Check that the policies of a row are different training seeds of one policy."""
    for name in ("inputs", "training"):
        values = dict.fromkeys(str(getattr(entrant, name)) for entrant in entrants)
        if len(values) > 1:
            raise UserError(
                f"The seeds of one policy must have equal {name}, got {' | '.join(values)}."
            )
    different = {e.digest or f"{e.spec}/{e.seed}" for e in entrants}
    if len(different) < len(entrants):
        specs = ", ".join(entrant.spec for entrant in entrants)
        raise UserError(f"Give each seed once, got {specs}.")


def _play_cell(suite: Suite, cell: Cell, entrant: Entrant) -> Outcome:
    """Play one cell with one seed of a policy and with its controls."""
    # Environments without an episode would repeat one, which controls then mix with the others.
    num_envs = min(entrant.num_envs, suite.episodes_played(cell.name, "control"))
    with closing(ArmVectorEnv(cell.env, num_envs)) as env:
        outcome = {"policy": _play(entrant.make(cell, env), env, cell.episodes)}
        first_episodes = cell.episodes[: suite.control_episodes]
        for name, agent in _controls(cell, entrant, env).items():
            outcome[name] = _play(agent, env, first_episodes)
    return outcome


def _required_controls(cell: Cell, inputs: Sequence[str]) -> list[str]:
    """Name the controls of every policy that has these inputs."""
    controls = ["open-loop"]
    if "image" in inputs:
        controls += ["black", "frozen"]
    if questions_of(cell.env) is not None and ("words" in inputs or "graph" in inputs):
        controls.append("shuffled query")
        if cell.env.task.skill.tells_facts:
            controls.append("shuffled facts")
    if cell.graph is not None and "graph" in inputs:
        controls.append("intact graph")
    return controls


def _controls(
    cell: Cell, entrant: Entrant, env: ArmVectorEnv
) -> dict[str, AgentProtocol]:
    own_graph = replace(cell, graph=None)
    makers: dict[str, Callable[[], AgentProtocol]] = {
        "open-loop": lambda: OpenLoopAgent(cell.open_loop),
        "black": lambda: BlindAgent(entrant.make(cell, env)),
        "frozen": lambda: FrozenAgent(entrant.make(cell, env)),
        "shuffled query": lambda: InformedAgent(entrant.make(cell, env), shuffled),
        "shuffled facts": lambda: InformedAgent(
            entrant.make(cell, env), with_other_facts
        ),
        "intact graph": lambda: entrant.make(own_graph, env),
    }
    agents = {name: makers[name]() for name in _required_controls(cell, entrant.inputs)}
    for name, make_control in entrant.controls.items():
        agents[name] = make_control(cell, env)
    return agents


def shuffled(batch: Batch) -> Batch:
    """Return a batch with the queries of other episodes."""
    order = np.random.default_rng(0).permutation(batch.size)
    return replace(batch, names=batch.names[order])


def with_other_facts(batch: Batch) -> Batch:
    """Return a batch with what holds in other episodes."""
    order = np.random.default_rng(0).permutation(batch.size)
    facts = {name: values[order] for name, values in batch.facts.items()}
    return replace(batch, facts=facts)


def _play(
    agent: AgentProtocol, env: ArmVectorEnv, episodes: Episodes
) -> dict[str, str]:
    """Play episodes; return success, and where the task has queries right choices, as hex."""
    result = play(agent, env, episodes)
    measures = {"success": result.success}
    if "is_right_object" in result.infos:
        measures["right"] = result.infos["is_right_object"].astype(bool)
    return {name: np.packbits(bits).tobytes().hex() for name, bits in measures.items()}


def _bits(text: str) -> Mask:
    data = np.frombuffer(bytes.fromhex(text), np.uint8)
    return np.unpackbits(data).astype(bool)


def _decoded(suite: Suite, row: Row, cell: str, who: str, measure: str) -> Mask:
    """Return the outcomes of a policy or control in a cell, (seeds, episodes).

    Raises:
        ValueError: they are those of another number of episodes.
    """
    count = suite.episodes_played(cell, who)
    outcomes = row["cells"][cell]["outcomes"]
    seeds = np.array([_bits(outcome[who][measure]) for outcome in outcomes])
    stored = seeds.shape[1]
    if stored != -(-count // 8) * 8:
        raise ValueError(f"outcomes of {stored} instead of {count} episodes")
    return seeds[:, :count]


def _figures(suite: Suite, row: Row) -> Row:
    """Compute the figures of every cell, and their means by table, from the episodes' outcomes."""
    cells: Row = {}
    for name, cell in row["cells"].items():
        outcomes = cell["outcomes"]
        figures: Row = {}
        for measure in outcomes[0]["policy"]:
            seeds = _decoded(suite, row, name, "policy", measure)
            figures[measure] = _share(seeds, seeds.shape[1])
        controls = {}
        for control in CONTROLS:
            if control in outcomes[0]:
                seeds = _decoded(suite, row, name, control, "success")
                controls[control] = float(seeds.mean(axis=1).mean())
        cells[name] = {**figures, "controls": controls, "outcomes": outcomes}
    summary = {}
    for table, names in by_table(map(suite.cells.__getitem__, cells)).items():
        controls = {}
        for control in CONTROLS:
            shares = [cells[name]["controls"].get(control) for name in names]
            if None not in shares:
                controls[control] = float(np.mean(shares))
        successes = [_decoded(suite, row, name, "policy", "success") for name in names]
        count = min(seeds.shape[1] for seeds in successes)
        success = _share(np.concatenate(successes, axis=1), count)
        summary[table] = {"cells": names, "success": success, "controls": controls}
    return {"cells": cells, "summary": summary}


def _share(seeds: Mask, episodes: int) -> Row:
    """Return a share with its interval, over training seeds if they differ, else over episodes.

    Args:
        seeds: outcomes, (training seeds, episodes). Seeds that end every episode in the same way
            count as one: they may be one policy, given twice.
        episodes: how many of a seed's outcomes are independent. Cells of a table share starts, and
            so do training seeds.
    """
    shares = seeds.mean(axis=1).tolist()
    by_outcomes = dict(zip(map(bytes, seeds), shares, strict=True))
    different = list(by_outcomes.values())
    if len(set(different)) > 1:
        interval = bootstrap(np.array(different))
    else:
        interval = wilson(round(shares[0] * episodes), episodes)
        interval = replace(interval, estimate=shares[0])
    return {
        "mean": interval.estimate,
        "low": interval.low,
        "high": interval.high,
        "seeds": shares,
    }


def query_gain(suite: Suite, row: Row, names: Sequence[str]) -> Interval | None:
    """Return how many more choices in cells are right with the own query than with another's.

    The interval is over training seeds if they differ, else over episodes; None without queries.
    """
    by_cell = []
    for name in names:
        first = row["cells"][name]["outcomes"][0]
        if "right" not in first.get("shuffled query", {}):
            return None
        with_other_query = _decoded(suite, row, name, "shuffled query", "right")
        with_query = _decoded(suite, row, name, "policy", "right")
        with_query = with_query[:, : with_other_query.shape[1]]
        # -1, 0 or 1 per choice
        by_cell.append(with_query.astype(float) - with_other_query)
    gains = np.concatenate(by_cell, axis=1)
    means = gains.mean(axis=1)
    return bootstrap(means if np.ptp(means) else gains[0], repetitions=2_000)


def read_row(path: Path) -> Row:
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
    try:
        suite = read_suite(str(row.get("suite")))
    except OSError as error:  # a name that no file can have
        raise UserError(f"{path}: suite: {error.strerror}.") from None
    if row.get("digest") != suite.digest:
        raise UserError(
            f"{path} was measured on another {suite.name}: the digests differ."
        )
    try:
        _check_declared(suite, row)
        computed = row | _figures(suite, row)
    except (AttributeError, KeyError, ValueError, TypeError, IndexError) as error:
        raise UserError(
            f"{path} is damaged: {error!r}. Measure the row again."
        ) from None
    as_stored = json.loads(json.dumps(computed))
    for where, (stored, follows) in differences(row, as_stored).items():
        raise UserError(
            f"{path}: {where} is {stored}, but its episodes give {follows}."
        )
    return row


def _check_declared(suite: Suite, row: Row) -> None:
    """Check the declarations of a row, and that every seed has every control.

    Raises:
        ValueError, TypeError, KeyError: what is wrong.
    """
    policy = row["policy"]
    specs = policy["specs"]
    digests = policy["digests"]
    for text in [row["name"], policy["training"], *policy["inputs"], *specs, *digests]:
        if not text.isprintable() or len(text) > MOST_TEXT:
            raise ValueError(
                f"{text!r:.40} is not one line of at most {MOST_TEXT} characters"
            )
    if not row["name"] or not row["cells"] or not specs:
        raise ValueError("it has no name, no cells or no policy")
    _check_names("it", row.keys() - {OPTIONAL_FIELD}, FIELDS)
    if unknown := set(policy["inputs"]) - set(INPUTS):
        raise ValueError(f"policy.inputs names {', '.join(unknown)}")
    for name in ("seeds", "digests"):
        if len(policy[name]) != len(specs):
            raise ValueError(f"policy.{name} and policy.specs differ in length")
    stated = list(filter(None, digests))
    if len(stated) > len(set(stated)):
        raise ValueError("policy.digests names one policy twice")
    for name, cell in row["cells"].items():
        needed = {"policy", *_required_controls(suite.cells[name], policy["inputs"])}
        for _, outcome in zip(specs, cell["outcomes"], strict=True):
            _check_names(
                f"cells.{name}.outcomes", outcome.keys() - OPTIONAL_CONTROLS, needed
            )


def _check_names(where: str, names: Any, needed: set[str]) -> None:
    if wrong := names ^ needed:
        raise ValueError(f"{where} lacks, or has, {', '.join(sorted(wrong))}")


def verify(
    row: Row,
    entrants: Entrants,
    *,
    tolerance: float = 0.0,
    report: Report = lambda line: None,
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
        raise UserError(
            f"tolerance must lie from 0 to below {MOST_TOLERANCE}, got {tolerance}."
        )
    suite = read_suite(row["suite"])
    declared = _declared(entrants)
    may_differ = ["specs"]
    if tolerance:
        may_differ.append("digests")
    for name in may_differ:
        declared[name] = row["policy"][name]
    for name, (stored, played) in differences(row["policy"], declared).items():
        raise UserError(
            f"policy.{name}: the row says {stored}, the given policy has {played}."
        )
    cells = list(row["cells"])
    again = run_suite(suite, entrants, name=row["name"], cells=cells, report=report)
    for name, cell in row["cells"].items():
        first = cell["outcomes"][0]
        if other := first.keys() ^ again["cells"][name]["outcomes"][0].keys():
            raise UserError(
                f"cells.{name}: the row and this policy do not have the same controls "
                f"({', '.join(sorted(other))})."
            )
        for who, measures in first.items():
            for measure in measures:
                old = _decoded(suite, row, name, who, measure)
                new = _decoded(suite, again, name, who, measure)
                for seed in np.flatnonzero((old != new).mean(axis=1) > tolerance):
                    raise UserError(
                        f"cells.{name}.outcomes[{seed}].{who}.{measure}: the row says "
                        f"{old[seed].sum()} of {old.shape[1]} episodes, playing gives "
                        f"{new[seed].sum()}; {(old[seed] != new[seed]).sum()} episodes end "
                        "otherwise."
                    )
