"""A graph goes in; a table of head, relation, tail comes out."""

import csv
from pathlib import Path

from knowarm.errors import UserError
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.read.label_choice import LABEL_RELATIONS
from knowarm.knowledge.read.table import HEADERS
from knowarm.knowledge.term import literal


def write_table(graph: KnowledgeGraph, path: Path, separator: str) -> None:
    """Write triples, then labels as rdfs:label triples. Entities without either are left out.

    Raises:
        UserError: a name holds a tab or line end, which TSV cannot hold.
    """
    labels = [
        (name, LABEL_RELATIONS[0], literal(text))
        for name, text in sorted(graph.own_labels().items())
    ]
    with path.open("w", encoding="utf-8", newline="") as file:
        if separator == ",":
            csv.writer(file, lineterminator="\n").writerows([HEADERS[0], *graph, *labels])
            return
        file.write("\t".join(HEADERS[0]) + "\n")
        for triple in (*graph, *labels):
            if any(bad in name for name in triple for bad in "\t\n\r"):
                raise UserError(
                    f"The triple {triple!r} holds a tab or line end, which TSV cannot hold. "
                    f"Write CSV or Turtle."
                )
            file.write("\t".join(triple) + "\n")
