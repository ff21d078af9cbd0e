"""`knowarm knowledge queries` and `subgraph`: questions, answers, splits, and one subgraph."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import compress, islice
from operator import itemgetter
from pathlib import Path
from typing import cast

import numpy as np

from knowarm.cli.knowledge.options import (
    OBJECTS,
    GraphOptions,
    ObjectOptions,
    short_names,
)
from knowarm.cli.tables import (
    TableCommand,
    Values,
    check_out,
    is_terminal,
    print_table,
)
from knowarm.config import check_values
from knowarm.errors import UserError, unknown_name
from knowarm.experiment.agents import AGENTS
from knowarm.knowledge import KnowledgeGraph, gamma, write_graph
from knowarm.knowledge.config import KnowledgeConfig
from knowarm.knowledge.draw import draw_svg
from knowarm.knowledge.formats import WRITTEN, read_graph
from knowarm.knowledge.graph.builder import difference, union
from knowarm.knowledge.graph.graph import Direction
from knowarm.knowledge.graph.statistics import graph_statistics
from knowarm.knowledge.graph.terms import local_name
from knowarm.knowledge.probe import query_agreement
from knowarm.knowledge.queries.queries import Pairs, QueryGraph
from knowarm.knowledge.queries.sparql import SparqlQuery
from knowarm.knowledge.queries.splits import SPLITS, QuerySplits, query_splits
from knowarm.questions import ObjectColour, QuestionTable
from knowarm.reading import read_text, write_text

Names = dict[str, list[str]]  # lists of names by what they are of
MOST_TRIPLES = 60  # most triples that are printed
MOST_HELD = 12  # most held-out pairs or new triples that are printed
MOST_ROWS = 500  # most conditions or queries that are printed
MOST_OBJECTS = 30  # most objects of one of them that are printed
MANY = (
    2_000  # with more facets than this, the work takes seconds and shows its progress
)


@dataclass(frozen=True, kw_only=True)
class Queries(ObjectOptions, TableCommand):
    """Show what a graph can be asked about objects, and what training and each test ask."""

    agent: str | None = None
    """Measure how well the knowledge of this agent reflects the answers, and show nothing else."""
    split: str | None = None
    """List the questions of a test, S1 to S5, instead of the overview."""
    pairs: Pairs = "colour"
    """Queries of two conditions: "none", one fact and one "colour", or "all" pairs."""
    objects_per_episode: int = 4
    """Number of objects in a scene."""
    hold_out: tuple[str, ...] = ("S2", "S3", "S4")
    """Splits whose questions training leaves out."""
    edited: str | None = None
    """Graph of S5; by default values of the graph are swapped."""
    seed: int = 0
    """Seed of what is held out."""
    most_objects: int = 1_500
    """Most objects that are taken where `--objects` names none."""

    def __post_init__(self) -> None:
        check_values(self)

    def result(self) -> Values:
        """Read the graph, make the tables and print them."""
        graph = self.read()
        facets = self._limited(self.facets(graph))
        query_graph = QueryGraph(graph, facets)
        if self.agent is not None:
            return self._print_agreement(self.agent, query_graph)
        splits = query_splits(
            graph,
            facets,
            seed=self.seed,
            pairs=self.pairs,
            objects=self.objects_per_episode,
            hold_out=self.hold_out,
            edited=None if self.edited is None else read_graph(self.edited),
            report=_print_progress if len(facets) > MANY else str,
        )
        if self.split is None:
            return _print_overview(query_graph, splits)
        questions = _questions(splits.test(self.split))
        rows = []
        for query, targets in questions.items():
            rows.append([query, _listed(list(targets))])
        _print_rows(f"{self.split}: {SPLITS[self.split]}", ["query", "targets"], rows)
        return {"split": self.split, "questions": questions}

    def _limited(self, facets: list[ObjectColour]) -> list[ObjectColour]:
        """Return the facets of the first objects, and say so, if there are too many."""
        objects = list(dict.fromkeys(map(itemgetter(0), facets)))
        if self.objects or len(objects) <= self.most_objects:
            return facets
        print(
            f"{len(objects):,} entities are heads of triples and tails of none. The first "
            f"{self.most_objects:,} are taken as objects: {objects[0]} to "
            f"{objects[self.most_objects - 1]}. --objects names others, --most-objects takes more."
        )
        kept = set(objects[: self.most_objects])
        return [facet for facet in facets if facet[0] in kept]

    def _print_agreement(self, agent: str, query_graph: QueryGraph) -> Values:
        known = {}
        for name, entry in AGENTS.items():
            if entry.knows.scope == "query":
                known[name] = entry.knows
        if agent not in known:
            raise unknown_name("agent with knowledge of queries", agent, known)
        knows = cast(KnowledgeConfig, known[agent])
        correlation = query_agreement(knows, query_graph, run_seed=self.seed)
        text = "undefined: all conditions are equally similar"
        if correlation is not None:
            text = f"{correlation:.3f}"
        print(
            f"Rank correlation of similar vectors and common answers, {agent}: {text}."
        )
        return {"agent": agent, "rank_correlation": correlation}


def _print_overview(query_graph: QueryGraph, splits: QuerySplits) -> Values:
    conditions = _print_conditions(query_graph, len(splits.train.queries))
    sizes = _print_sizes(splits, conditions)
    for name, reason in splits.reasons.items():
        print(f"No {name} ({SPLITS[name]}): {reason}")
    held_out = _held_out(query_graph, splits)
    for name, words in held_out.items():
        what = "New in the graph of" if name == "S5" else "Held out for"
        listed = "; ".join(words[:MOST_HELD]) or "nothing"
        if len(words) > MOST_HELD:
            listed += f"; ... ({len(words)}, --json FILE writes all)"
        print(f"{what} {name}: {listed}.")
    return {
        "conditions": conditions,
        "splits": sizes,
        "held_out": held_out,
        "empty": splits.reasons,
    }


def _print_conditions(query_graph: QueryGraph, query_count: int) -> Names:
    """Print the objects that satisfy each condition, and return them by its name."""
    queries = query_graph.queries("none")
    conditions = {}
    rows = []
    for query, is_answer in zip(queries, query_graph.answers(queries), strict=True):
        names = list(dict(compress(query_graph.facets, is_answer)))
        conditions[query.name] = names
        is_all = len(names) == len(query_graph.objects)
        rows.append([query.name, "all" if is_all else _listed(names)])
    title = f"{query_count} queries: {len(queries)} of one condition"
    _print_rows(title, ["condition", "objects"], rows)
    return conditions


def _listed(names: Sequence[str]) -> str:
    """Return the first names of objects, and how many more there are."""
    text = ", ".join(names[:MOST_OBJECTS])
    if len(names) > MOST_OBJECTS:
        text += f" and {len(names) - MOST_OBJECTS:,} more"
    return text


def _print_rows(
    title: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
) -> None:
    """Print the first rows of a table, and say how many more there are."""
    print_table(title, columns, rows[:MOST_ROWS])
    if len(rows) > MOST_ROWS:
        print(f"... and {len(rows) - MOST_ROWS:,} more; --json FILE writes all.")


def _print_progress(line: str) -> None:
    """Print a line that the next one overwrites on a terminal."""
    if is_terminal():
        print(f"{line:<60}", end="\r", flush=True)
    elif line:
        print(line, flush=True)


def _print_sizes(splits: QuerySplits, conditions: Names) -> dict[str, dict[str, int]]:
    """Print the size of each split, and return them; ``conditions`` name queries of one."""
    sizes = {}
    rows = []
    for name, table in {"training": splits.train, **splits.tests}.items():
        is_single = [query.name in conditions for query in table.queries]
        sizes[name] = {
            "questions": int(table.askable.sum()),
            "of_one_condition": int(table.askable[is_single].sum()),
            "facets_shown": int(table.shown.sum()),
        }
        about = SPLITS.get(name, "without the questions that the tests below hold out")
        rows.append([name, about, *sizes[name].values()])
    columns = ["table", "asks", "questions", "of one condition", "facets shown"]
    print_table("Splits", columns, rows)
    return sizes


def _held_out(query_graph: QueryGraph, splits: QuerySplits) -> Names:
    """Return what training leaves out, and what is new in the edited graph, by split."""
    held = splits.held_out
    edits = set(splits.edited or ()) - set(query_graph.graph)
    return {
        "S2": sorted(f"{name}: {condition.name}" for condition, name in held.pairs),
        "S3": [],
        **{split: sorted(objects) for split, objects in held.new.items()},
        "S4": sorted(held.values),
        "S5": sorted(map(" ".join, edits)),
    }


def _questions(table: QuestionTable) -> dict[str, Names]:
    """Return the targets of every query that a table asks: colours by object."""
    questions: dict[str, Names] = {}
    for query, facet in np.argwhere(table.askable):
        name, colour = table.facets[facet]
        colours = questions.setdefault(table.queries[query].name, {})
        colours.setdefault(name, []).append(colour)
    return questions


@dataclass(frozen=True, kw_only=True)
class SelectionOptions(GraphOptions):
    """A graph and the neighbourhood of objects in it."""

    objects: tuple[str, ...] = ()
    """Objects whose neighbourhood is selected; none selects the whole graph."""
    hops: int = 1
    """Largest number of edges from the objects."""
    direction: Direction = "out"
    """Edges to follow: "out" (the object is the head), "in" or "both"."""
    relations: tuple[str, ...] | None = None
    """Relations to follow; None follows all."""
    max_degree: int | None = None
    """Entities with more edges than this are not expanded, but for the objects themselves; None
    sets no limit."""

    def select(self, graph: KnowledgeGraph) -> KnowledgeGraph:
        """Return the neighbourhood of the objects."""
        if not self.objects:
            return graph
        return gamma(
            graph,
            self.objects,
            hops=self.hops,
            direction=self.direction,
            relations=self.relations,
            max_degree=self.max_degree,
        )


@dataclass(frozen=True, kw_only=True)
class Draw(SelectionOptions):
    """Draw the neighbourhood of objects as SVG."""

    out: Path
    """The SVG file to write."""
    objects: tuple[str, ...] = OBJECTS
    """Objects of the first column; none (`--objects` alone) draws the whole graph."""
    title: str = ""
    """Heading of the drawing."""

    def run(self) -> None:
        """Select, draw and write."""
        graph = self.select(self.read())
        drawing = draw_svg(graph, self.objects, self.title)
        write_text(self.out, drawing, "Give another path.")
        print(f"Wrote {self.out}")
        print(f"{len(graph)} triples, {len(graph.nodes)} entities")


@dataclass(frozen=True, kw_only=True)
class Subgraph(SelectionOptions, TableCommand):
    """Select a part of a graph, print it, and optionally write it in another format."""

    union: str | None = None
    """Add the triples of this graph before the selection."""
    minus: str | None = None
    """Remove the triples of this graph before the selection."""
    sparql: str | None = None
    """Run this SPARQL query (or the query in this .rq file) instead; `:mug` is the entity mug."""
    statistics: bool = False
    """Print counts, hubs, cycles and shared labels instead of the triples."""
    out: Path | None = None
    """Write the result: .ttl, .nt, .rdf, .jsonld, .csv or .tsv."""

    def result(self) -> Values:
        """Select, print and write."""
        check_out(self.out, "graphs", tuple(WRITTEN))
        graph = self.read()
        if self.union is not None:
            graph = union(graph, read_graph(self.union))
        if self.minus is not None:
            graph = difference(graph, read_graph(self.minus))
        if self.sparql is None:
            graph = self.select(graph)
        else:
            query = SparqlQuery(graph, _text(self.sparql))
            answer = query.answer()
            if answer.is_nothing and query.hint:
                print(query.hint)
            if answer.graph is None:
                return self._print_answers(answer.columns, answer.rows)
            graph = answer.graph
        printed = _print_statistics(graph) if self.statistics else _print_triples(graph)
        if self.out is not None:
            write_graph(graph, self.out)
            print(f"Wrote {self.out}")
        return {"triples": len(graph), "entities": len(graph.nodes), **printed}

    def _print_answers(
        self,
        columns: Sequence[str],
        answers: Sequence[Sequence[str]],
    ) -> Values:
        if self.out is not None:
            raise UserError(
                "--out writes a graph, but SELECT and ASK return none. Use CONSTRUCT."
            )
        print_table(f"{len(answers)} answers", columns, short_names(answers))
        return {"columns": list(columns), "rows": list(map(list, answers))}


def _text(query: str) -> str:
    """Return a query, or the content of a query file."""
    if "\n" in query or not query.endswith((".rq", ".sparql")):
        return query
    return read_text(Path(query), remedy="Give a file of one SPARQL query in UTF-8.")


def _print_triples(graph: KnowledgeGraph) -> Values:
    title = f"{len(graph):,} triples, {len(graph.nodes):,} entities"
    print_table(
        title, ["head", "relation", "tail"], short_names(islice(graph, MOST_TRIPLES))
    )
    if len(graph) > MOST_TRIPLES:
        print(f"... and {len(graph) - MOST_TRIPLES:,} more; --out FILE writes all.")
    return {"facts": list(graph)}


def _print_statistics(graph: KnowledgeGraph) -> Values:
    statistics = graph_statistics(graph)
    values = statistics._asdict()
    counts = [(name, value) for name, value in values.items() if isinstance(value, int)]
    print_table("Graph", ["what", "count"], counts)
    _print_counts("Relations", ["relation", "triples"], statistics.by_relation.items())
    _print_counts("Hubs", ["entity", "edges"], statistics.hubs)
    for relation, entities in statistics.cycles:
        names = ", ".join(map(local_name, entities))
        print(f"Cycle along {local_name(relation)}: {names}.")
    for label, owners in statistics.same_labels.items():
        print(
            f"The label {label!r} belongs to {len(owners)} entities: {', '.join(owners)}."
        )
    return values


def _print_counts(
    title: str,
    columns: Sequence[str],
    counts: Iterable[tuple[str, int]],
) -> None:
    """Print a table of entities or relations with a count of each."""
    rows = [(local_name(name), count) for name, count in counts]
    print_table(title, columns, rows)
