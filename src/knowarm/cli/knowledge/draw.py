"""`knowarm knowledge draw`: objects go in; an SVG drawing of what the graph says comes out."""

from dataclasses import dataclass
from pathlib import Path

from knowarm.cli.knowledge.options import GraphOptions, write_text
from knowarm.knowledge import gamma
from knowarm.knowledge.draw import draw_svg
from knowarm.knowledge.subgraph import Direction
from knowarm.knowledge.task import TASK_COLOURS


@dataclass(frozen=True, kw_only=True)
class Draw(GraphOptions):
    """Draw the neighbourhood of objects."""

    out: Path
    """The SVG file to write."""
    objects: tuple[str, ...] = tuple(TASK_COLOURS)
    """Objects of the first column; none (`--objects` alone) draws the whole graph."""
    hops: int = 1
    """How many edges from the objects."""
    direction: Direction = "out"
    """Edges to follow: "out" (the object is the head), "in" or "both"."""
    relations: tuple[str, ...] | None = None
    """Relations to follow; None follows all."""
    title: str = ""
    """Heading of the drawing."""

    def run(self) -> None:
        """Select, draw and write."""
        graph = self.read()
        if self.objects:
            graph = gamma(
                graph,
                self.objects,
                hops=self.hops,
                direction=self.direction,
                relations=self.relations,
            )
        text = draw_svg(graph, self.objects, self.title)
        write_text(self.out, text)
        print(f"{len(graph)} triples, {len(graph.nodes)} entities")
