"""Options shared by the `knowarm knowledge` commands: graph, objects, embedding and source."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from knowarm.errors import UserError, unknown_name
from knowarm.knowledge import FULL, KnowledgeConfig, KnowledgeGraph, read_graph
from knowarm.knowledge.facets import graph_facets
from knowarm.knowledge.formats import open_graph
from knowarm.knowledge.scene import load_graph
from knowarm.knowledge.vectors import Source, source_named
from knowarm.world.config import EnvConfig
from knowarm.world.objects import TARGETS

OBJECTS = EnvConfig().targets
"""The default task's objects."""


@dataclass(frozen=True, kw_only=True)
class GraphOptions:
    """The graph that a command works on."""

    graph: Annotated[Path | None, tyro.conf.Positional] = None
    """A graph file, an OpenKE folder or a shipped graph; "household" by default."""
    format: str | None = None
    """The file's format ("turtle", "ntriples", ...); by default that of its suffix."""

    def read(self) -> KnowledgeGraph:
        """Read the graph."""
        if self.graph is None or self.format is None:
            return open_graph(self.graph)
        return read_graph(self.graph, self.format)


@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """The objects of a scene and the embedding of their facts.

    `--source NAME` takes a short name: wordnet-gloss-50, the path of a GloVe or .safetensors file,
    a graph-embedding model (analogy, ...), a placebo (zeros, ...), sentence-transformers:PATH.
    """

    objects: tuple[str, ...] = OBJECTS
    """Names of the objects."""
    colours: Literal["fixed", "randomized"] = "randomized"
    """One colour per object, or all that it can have."""
    agent: str | None = None
    """Take the settings of this agent (see `knowarm list`) and ignore those below."""
    knowledge: Annotated[KnowledgeConfig, tyro.conf.arg(name="")] = field(
        default_factory=lambda: FULL
    )
    """Settings of the embedding."""

    def config(self) -> KnowledgeConfig:
        """Return the settings of the agent, or the given ones."""
        if self.agent is None:
            return self.knowledge
        from knowarm.experiment.agents import AGENTS  # imports torch, which takes seconds

        if self.agent not in AGENTS:
            raise unknown_name("agent", self.agent, AGENTS)
        return AGENTS[self.agent].knowledge

    def facets(self) -> list[tuple[str, str]]:
        """Return the (object, colour) pairs: a target's colours are its own, else the graph's."""
        config, facets = self.config(), []
        for name in self.objects:
            if name in TARGETS:
                pairs = [(name, colour) for colour in TARGETS[name].colours]
            else:
                pairs = graph_facets([name], load_graph(config), config.colour_relation)
            facets += pairs[:1] if self.colours == "fixed" else pairs
        return facets


def take_source(arguments: Sequence[str], flag: str) -> tuple[list[str], Source | None]:
    """Take the short name of a source out of command-line arguments.

    Args:
        arguments: the words of the command line.
        flag: the option: "--source" of `--source analogy` or `--source=analogy`. Options of its
            fields (`--source.file`) are left in place.

    Returns:
        The other arguments, and the source if there is one.
    """
    rest, source = [], None
    words = iter(arguments)
    for word in words:
        if word == flag:
            name = next(words, None)
            if name is None or name.startswith("--"):
                raise UserError(f"{flag} needs a name, e.g. {flag} analogy.")
            source = source_named(name)
        elif word.startswith(f"{flag}="):
            source = source_named(word.removeprefix(f"{flag}="))
        else:
            rest.append(word)
    return rest, source


def write_text(path: Path, text: str) -> None:
    """Write a file and print its path.

    Raises:
        UserError: it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise UserError(f"Cannot write {path}: {error.strerror}. Give another path.") from error
    print(f"Wrote {path}")
