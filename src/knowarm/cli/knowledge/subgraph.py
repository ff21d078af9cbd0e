"""`knowarm knowledge subgraph` and `draw`: select, query, unite, write and draw graphs."""

from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from knowarm.cli.knowledge.options import OBJECTS, GraphOptions, check_suffix, writing
from knowarm.cli.tables import TableCommand, print_table
from knowarm.errors import UserError
from knowarm.knowledge import KnowledgeGraph, gamma, read_graph, write_graph
from knowarm.knowledge.draw import draw_svg
from knowarm.knowledge.formats import WRITERS
from knowarm.knowledge.graph.builder import difference, union
from knowarm.knowledge.graph.graph import Direction
from knowarm.knowledge.graph.sparql import sparql
from knowarm.knowledge.graph.statistics import graph_statistics
from knowarm.knowledge.graph.terms import local_name

SHOWN = 60  # largest number of triples that are printed


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
        names = ("hops", "direction", "relations", "max_degree")
        return gamma(graph, self.objects, **{name: getattr(self, name) for name in names})


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
        with writing(self.out):
            self.out.write_text(draw_svg(graph, self.objects, self.title), encoding="utf-8")
        print(f"{len(graph)} triples, {len(graph.nodes)} entities")


@dataclass(frozen=True, kw_only=True)
class Subgraph(SelectionOptions, TableCommand):
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

    def result(self) -> dict[str, Any]:
        """Select, print and write."""
        check_suffix(self.out, "graphs", tuple(WRITERS))
        graph = self.read()
        if self.union is not None:
            graph = union(graph, read_graph(self.union))
        if self.minus is not None:
            graph = difference(graph, read_graph(self.minus))
        if self.sparql is not None:
            answer = sparql(graph, _text(self.sparql))
            if answer.graph is None:
                if self.out is not None:
                    need = "--out writes a graph, but SELECT and ASK return none"
                    raise UserError(f"{need}. Use CONSTRUCT.")
                shown = [list(map(local_name, row)) for row in answer.rows]
                print_table(f"{len(shown)} answers", answer.columns, shown)
                return {"columns": list(answer.columns), "rows": list(map(list, answer.rows))}
            graph = answer.graph
        else:
            graph = self.select(graph)
        printed = _print_statistics(graph) if self.statistics else _print_triples(graph)
        if self.out is not None:
            write_graph(graph, self.out)
            print(f"Wrote {self.out}")
        return {"triples": len(graph), "entities": len(graph.nodes), **printed}


def _text(query: str) -> str:
    """Return a query, or the content of a query file."""
    if "\n" in query or not query.endswith((".rq", ".sparql")):
        return query
    if not Path(query).is_file():
        raise UserError(f"There is no query file {query}.")
    return Path(query).read_text()


def _print_triples(graph: KnowledgeGraph) -> dict[str, Any]:
    rows = [[local_name(name) for name in triple] for triple in islice(graph, SHOWN)]
    title = f"{len(graph):,} triples, {len(graph.nodes):,} entities"
    print_table(title, ["head", "relation", "tail"], rows)
    if len(graph) > SHOWN:
        print(f"... and {len(graph) - SHOWN:,} more; --out FILE writes all.")
    return {"facts": list(graph)}


def _print_statistics(graph: KnowledgeGraph) -> dict[str, Any]:
    found = graph_statistics(graph)
    values = found._asdict()
    single = [each for each in values.items() if isinstance(each[1], int)]
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
