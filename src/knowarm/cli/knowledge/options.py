"""What several `knowledge` commands ask: which objects, which graph, which settings."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from knowarm.errors import UserError, unknown_name
from knowarm.knowledge import KNOWLEDGE, KnowledgeConfig, KnowledgeGraph, household, read_graph
from knowarm.knowledge.scene import load_graph
from knowarm.knowledge.task import TASK_COLOURS, task_facets


@dataclass(frozen=True, kw_only=True)
class GraphOptions:
    """The graph that a command works on."""

    graph: Annotated[Path | None, tyro.conf.Positional] = None
    """A graph file, or an OpenKE folder; left out, the shipped household graph."""
    format: str | None = None
    """The file's format ("turtle", "ntriples", ...); left out, by its suffix."""

    def read(self) -> KnowledgeGraph:
        """Read the graph."""
        return household() if self.graph is None else read_graph(self.graph, self.format)


@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """The objects of a scene and how they become a vector."""

    objects: tuple[str, ...] = tuple(TASK_COLOURS)
    """Names of the objects."""
    colours: Literal["fixed", "randomized"] = "randomized"
    """One colour an object, or all that it can have."""
    agent: str | None = None
    """Take all settings from this agent ("full", "full+", ...) and none of those below."""
    knowledge: Annotated[KnowledgeConfig, tyro.conf.OmitArgPrefixes] = field(
        default_factory=lambda: KnowledgeConfig(detail="full")
    )
    """Settings of the embedding."""

    def config(self) -> KnowledgeConfig:
        """Return the settings: the agent's, or the ones given."""
        if self.agent is None:
            return self.knowledge
        if self.agent not in KNOWLEDGE:
            raise unknown_name("agent", self.agent, KNOWLEDGE)
        return KNOWLEDGE[self.agent]

    def facets(self) -> list[tuple[str, str]]:
        """Return the (object, colour) pairs of the scene."""
        config = self.config()
        graph = load_graph(config)
        return task_facets(self.objects, self.colours, graph, config.colour_relation)


def write_text(path: Path, text: str) -> None:
    """Write a file and say so.

    Raises:
        UserError: it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UserError(f"Cannot write {path}: {error.strerror}. Give another place.") from error
    print(f"Wrote {path}")
