"""`knowarm knowledge subgraph` and `draw`: select, query, unite, write and draw graphs."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from knowarm.cli.knowledge.options import OBJECTS, GraphOptions, write_text
from knowarm.cli.tables import check_json_path, print_table, write_json_table
from knowarm.errors import UserError
from knowarm.knowledge import KnowledgeGraph, gamma, read_graph, write_graph
from knowarm.knowledge.builder import difference, union
from knowarm.knowledge.draw import draw_svg
from knowarm.knowledge.formats import WRITERS
from knowarm.knowledge.sparql import sparql
from knowarm.knowledge.statistics import graph_statistics
from knowarm.knowledge.subgraph import Direction
from knowarm.knowledge.terms import local_name

SHOWN = 60
"""Largest number of triples that are printed."""


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
    """Entities with more edges than this are not expanded; None sets no limit."""

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
        write_text(self.out, draw_svg(graph, self.objects, self.title))
        print(f"{len(graph)} triples, {len(graph.nodes)} entities")


@dataclass(frozen=True, kw_only=True)
class Subgraph(SelectionOptions):
    """Select a part of a graph, print it, and optionally write it in another format."""

    union: Path | None = None
    """Add the triples of this graph before the selection."""
    minus: Path | None = None
    """Remove the triples of this graph before the selection."""
    sparql: str | None = None
    """Run this SPARQL query (or the query in this .rq file) instead; `:mug` is the entity mug."""
    statistics: bool = False
    """Print counts, hubs, cycles and shared labels instead of the triples."""
    out: Path | None = None
    """Write the result: .ttl, .nt, .rdf, .jsonld, .csv or .tsv."""
    json: Path | None = None
    """Write the same as JSON to this file."""

    def run(self) -> None:
        """Select, print and write."""
        check_json_path(self.json)
        if self.out is not None and self.out.suffix not in WRITERS:
            raise UserError(f"--out {self.out}: graphs are written as {', '.join(WRITERS)}.")
        graph = self.read()
        if self.union is not None:
            graph = union(graph, read_graph(self.union))
        if self.minus is not None:
            graph = difference(graph, read_graph(self.minus))
        if self.sparql is not None:
            answer = sparql(graph, _text(self.sparql))
            if answer.graph is None:
                self._print_answer(answer.columns, answer.rows)
                return
            graph = answer.graph
        else:
            graph = self.select(graph)
        values: dict[str, Any] = {"triples": len(graph), "entities": len(graph.nodes)}
        if self.statistics:
            values |= _print_statistics(graph)
        else:
            values |= _print_triples(graph)
        if self.out is not None:
            write_graph(graph, self.out)
            print(f"Wrote {self.out}")
        write_json_table(self.json, values)

    def _print_answer(self, columns: tuple[str, ...], rows: tuple[tuple[str, ...], ...]) -> None:
        if self.out is not None:
            raise UserError("--out writes a graph, but SELECT and ASK return none. Use CONSTRUCT.")
        print_table(f"{len(rows)} answers", columns, [[local_name(n) for n in r] for r in rows])
        write_json_table(self.json, {"columns": list(columns), "rows": [list(r) for r in rows]})


def _text(query: str) -> str:
    """Return a query, or the content of a query file."""
    path = Path(query)
    is_file = "\n" not in query and len(query) < 200 and path.suffix in (".rq", ".sparql")
    if is_file and not path.is_file():
        raise UserError(f"There is no query file {path}.")
    return path.read_text() if is_file else query


def _print_triples(graph: KnowledgeGraph) -> dict[str, Any]:
    rows = []
    for number, triple in enumerate(graph):
        if number == SHOWN:
            break
        rows.append([local_name(name) for name in triple])
    title = f"{len(graph):,} triples, {len(graph.nodes):,} entities"
    print_table(title, ["head", "relation", "tail"], rows)
    if len(graph) > SHOWN:
        print(f"... and {len(graph) - SHOWN:,} more; --out FILE writes all.")
    return {"facts": list(graph)}


def _print_statistics(graph: KnowledgeGraph) -> dict[str, Any]:
    found = graph_statistics(graph)
    values = found.describe()
    single = [(key, value) for key, value in values.items() if isinstance(value, int)]
    print_table("Graph", ["what", "count"], single)
    relations = [(local_name(name), count) for name, count in found.by_relation.items()]
    print_table("Relations", ["relation", "triples"], relations)
    print_table("Hubs", ["entity", "edges"], [(local_name(n), count) for n, count in found.hubs])
    for relation, entities in found.cycles:
        names = ", ".join(map(local_name, entities))
        print(f"Cycle along {local_name(relation)}: {names}.")
    for label, owners in found.same_labels.items():
        print(f"The label {label!r} belongs to {len(owners)} entities: {', '.join(owners)}.")
    return values
