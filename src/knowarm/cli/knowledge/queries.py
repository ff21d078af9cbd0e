"""`knowarm knowledge queries`: what a graph can be asked, the answers, and the splits."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from knowarm.cli.knowledge.options import GraphOptions
from knowarm.cli.tables import check_json_path, print_table, write_json_table
from knowarm.errors import unknown_name
from knowarm.knowledge import KnowledgeGraph
from knowarm.knowledge.facets import graph_facets
from knowarm.knowledge.formats import open_graph
from knowarm.knowledge.probe import query_agreement
from knowarm.knowledge.queries import COLOUR_RELATION, Pairs, QueryGraph
from knowarm.knowledge.query_splits import SPLITS, QuerySplits, QueryTable, query_splits
from knowarm.knowledge.terms import local_name
from knowarm.world.objects import COLOURS, TARGETS

SHOWN = 12
"""Most held-out pairs or new triples that are printed."""


@dataclass(frozen=True, kw_only=True)
class Queries(GraphOptions):
    """Show what a graph can be asked about objects, and what training and each test ask."""

    graph: Annotated[Path | None, tyro.conf.Positional] = Path("objects")
    """A graph file, an OpenKE folder or a shipped graph; by default that of the choice task."""
    objects: tuple[str, ...] = ()
    """Objects of the task; by default every entity that is the head of a triple and the tail of
    none, and no colour."""
    colours: tuple[str, ...] = tuple(COLOURS)
    """Colours of objects that are no targets and of which the graph states none."""
    ask: str | None = None
    """Answer one query, such as "usedFor drinking and hasColor blue", and show nothing else."""
    agent: str | None = None
    """Measure how well what this agent is told reflects the answers, and show nothing else."""
    split: str | None = None
    """List the questions of a test, S1 to S5, instead of the overview."""
    pairs: Pairs = "colour"
    """Queries of two conditions: "none", one fact and one "colour", or "all" pairs."""
    objects_per_episode: int = 4
    """Number of objects in a scene."""
    hold_out: tuple[str, ...] = ("S2", "S3", "S4")
    """Splits whose questions training leaves out."""
    edited: Path | None = None
    """Graph of S5; by default values of the graph are swapped."""
    seed: int = 0
    """Seed of what is held out."""
    json: Path | None = None
    """Write the same as JSON to this file."""

    def run(self) -> None:
        """Read the graph, make the tables and print them."""
        check_json_path(self.json)
        graph = self.read()
        facets = self._facets(graph)
        asked = QueryGraph(graph, facets)
        if self.ask is not None:
            query = asked.parse(self.ask)
            found = [asked.facets[i] for i in np.flatnonzero(asked.answers([query])[0])]
            print_table(f"Answers to {query.name!r}", ["object", "colour"], found)
            write_json_table(self.json, {"query": query.name, "answers": found})
            return
        if self.agent is not None:
            self._print_agreement(self.agent, asked)
            return
        splits = query_splits(
            graph,
            facets,
            seed=self.seed,
            pairs=self.pairs,
            objects=self.objects_per_episode,
            hold_out=self.hold_out,
            edited=None if self.edited is None else open_graph(self.edited),
        )
        if self.split is not None:
            questions = _questions(splits.test(self.split))
            values: dict[str, Any] = {"split": self.split, "questions": questions}
            rows = [[query, ", ".join(targets)] for query, targets in questions.items()]
            print_table(f"{self.split}: {SPLITS[self.split]}", ["query", "targets"], rows)
        else:
            values = _print_overview(asked, splits)
        write_json_table(self.json, values)

    def _print_agreement(self, agent: str, asked: QueryGraph) -> None:
        from knowarm.experiment.agents import AGENTS  # imports torch, which takes seconds

        told = [name for name, each in AGENTS.items() if each.knowledge.scope == "query"]
        if agent not in told:
            raise unknown_name("agent that is told queries", agent, told)
        found = query_agreement(AGENTS[agent].knowledge, asked, run_seed=self.seed)
        shown = "undefined: all conditions are equally similar" if found is None else f"{found:.3f}"
        print(f"Rank correlation of similar vectors and common answers, {agent}: {shown}.")
        write_json_table(self.json, {"agent": agent, "rank_correlation": found})

    def _facets(self, graph: KnowledgeGraph) -> list[tuple[str, str]]:
        names = self.objects or [
            name
            for name in (local_name(graph.names[i]) for i in np.setdiff1d(graph.heads, graph.tails))
            if name not in self.colours
        ]
        states_colours = COLOUR_RELATION in map(local_name, graph.relations_used)
        facets = []
        for name in names:
            pairs = [(name, colour) for colour in self.colours]
            if name in TARGETS:
                pairs = [(name, colour) for colour in TARGETS[name].colours]
            elif states_colours:
                stated = graph_facets([name], graph)
                pairs = stated if stated[0][1] else pairs
            facets += pairs
        return facets


def _print_overview(asked: QueryGraph, splits: QuerySplits) -> dict[str, Any]:
    single = asked.queries("none")
    answers = asked.answers(single)
    conditions = {
        query.name: list(dict.fromkeys(asked.facets[i][0] for i in np.flatnonzero(row)))
        for query, row in zip(single, answers, strict=True)
    }
    print_table(
        f"{len(splits.train.queries)} queries: {len(single)} of one condition",
        ["condition", "objects"],
        [
            [name, "all" if len(names) == len(asked.objects) else ", ".join(names)]
            for name, names in conditions.items()
        ],
    )
    tables = {"training": splits.train, **splits.tests}
    sizes = {
        name: {
            "questions": int(table.askable.sum()),
            "of_one_condition": int(table.askable[[q in conditions for q in table.queries]].sum()),
            "facets_shown": int(table.shown.sum()),
        }
        for name, table in tables.items()
    }
    about = {"training": "what is held out below is not asked", **SPLITS}
    print_table(
        "Splits",
        ["table", "asks", "questions", "of one condition", "facets shown"],
        [[name, about[name], *size.values()] for name, size in sizes.items()],
    )
    for name, reason in splits.reasons.items():
        print(f"No {name} ({SPLITS[name]}): {reason}")
    held = splits.held_out
    kept = {
        "S2": sorted(f"{name}: {condition.name}" for condition, name in held.pairs),
        "S3": sorted(held.objects),
        "S4": sorted(held.values),
        "S5": sorted(" ".join(triple) for triple in set(splits.edited or ()) - set(asked.graph)),
    }
    for name, words in kept.items():
        what = "New in the graph of" if name == "S5" else "Held out for"
        more = f"; ... ({len(words)}, --json FILE writes all)" if len(words) > SHOWN else ""
        print(f"{what} {name}: {'; '.join(words[:SHOWN]) or 'nothing'}{more}.")
    return {"conditions": conditions, "splits": sizes, "held_out": kept, "empty": splits.reasons}


def _questions(table: QueryTable) -> dict[str, dict[str, list[str]]]:
    """Return the targets of every query that a table asks: colours by object."""
    questions = {}
    for text, row in zip(table.queries, table.askable, strict=True):
        colours: dict[str, list[str]] = {}
        for facet in np.flatnonzero(row):
            name, colour = table.facets[facet]
            colours.setdefault(name, []).append(colour)
        if colours:
            questions[text] = colours
    return questions
