"""Options shared by the `knowarm knowledge` commands: graph, objects, embedding and source."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from tyro.conf import arg

from knowarm.cli.arguments import parse_options, take_source
from knowarm.cli.tables import TableCommand
from knowarm.errors import UserError, unknown_name
from knowarm.experiment.agents import AGENTS
from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.knows import NoKnowledge
from knowarm.knowledge import FULL, KnowledgeConfig, KnowledgeGraph, read_graph
from knowarm.knowledge.graph.homonyms import best_described, find_objects
from knowarm.knowledge.graph.terms import local_name
from knowarm.knowledge.slots import graph_facets
from knowarm.questions import COLOUR_RELATION
from knowarm.world.config import EnvConfig, facets_of
from knowarm.world.objects import TARGETS
from knowarm.world.objects.target import COLOURS

OBJECTS = EnvConfig().targets  # the default task's objects


@dataclass(frozen=True, kw_only=True)
class GraphOptions:
    """The graph that a command works on."""

    graph: str | None = None  # no `Path`, which would drop the "./" of a file
    """A graph file, a folder of triples or a shipped graph; "household" by default."""
    format: str | None = None
    """The file's format ("turtle", "ntriples", ...); by default recognized."""

    def read(self) -> KnowledgeGraph:
        """Read the graph."""
        return read_graph(self.graph, self.format)


@dataclass(frozen=True, kw_only=True)
class ObjectOptions(GraphOptions):
    """The objects with colours about which a graph is asked."""

    graph: str | None = "objects"
    """A graph file, a folder of triples or a shipped graph; by default that of the choose task."""
    objects: tuple[str, ...] = ()
    """Objects of the task; by default every entity that is the head of a triple and the tail of
    none, and no colour."""
    colours: tuple[str, ...] = tuple(COLOURS)
    """Colours of objects that are no targets and of which the graph states none."""

    def facets(self, graph: KnowledgeGraph) -> list[tuple[str, str]]:
        """Return the objects with the colours that each can have."""
        states_colours = COLOUR_RELATION in map(local_name, graph.relations_used)
        facets: list[tuple[str, str]] = []
        for name in self.objects or self._names(graph):
            colours = self.colours
            if name in TARGETS:
                colours = tuple(TARGETS[name].colours)
            elif states_colours and any(_colours_in(graph, name)):
                colours = _colours_in(graph, name)
            facets += product([name], colours)
        return facets

    def _names(self, graph: KnowledgeGraph) -> Iterator[str]:
        """Yield the names of the heads that are tails of no triple, each the one of a name."""
        for entity in np.setdiff1d(graph.heads, graph.tails).tolist():
            name = graph.names.short(entity)
            is_object = not name.startswith("_:") and name not in self.colours
            if is_object and best_described(graph, name) == [entity]:
                yield name


def _colours_in(
    graph: KnowledgeGraph,
    name: str,
    relation: str = COLOUR_RELATION,
) -> tuple[str, ...]:
    """Return the colours that a graph states of an object, or "" alone."""
    return tuple(colour for _, colour in graph_facets([name], graph, relation))


@dataclass(frozen=True, kw_only=True)
class SceneOptions(TableCommand):
    """The objects of a scene and the embedding of their facts.

    `--source NAME` takes a short name: wordnet-gloss-50, glove-6b-50, the path of a GloVe or
    .safetensors file, a graph-embedding model (analogy, ...), a placebo (zeros, ...),
    sentence-transformers:PATH.
    """

    objects: tuple[str, ...] = OBJECTS
    """Names of the objects."""
    colours: Literal["fixed", "randomized"] = "randomized"
    """One colour per object, or all that it can have."""
    agent: str | None = None
    """Take the settings of this agent (see `knowarm list agents`), without those below; or those of
    this run folder, and its objects and colours."""
    knowledge: Annotated[KnowledgeConfig, arg(name="")] = field(
        default_factory=lambda: FULL
    )
    """Settings of the embedding."""

    @classmethod
    def parse(cls, prog: str, arguments: Sequence[str]) -> Self:
        """Make a command from its options; `--source` takes the short name of a source."""
        words, source = take_source(arguments, "--source")
        default = source and cls(
            knowledge=KnowledgeConfig(detail="full", source=source)
        )
        return parse_options(cls, prog, words, default=default)

    def scene(self) -> tuple[KnowledgeConfig, list[tuple[str, str]], int]:
        """Return the settings, the (object, colour) pairs, and the seed that placebos draw from."""
        run = self._run()
        config = self._config(run)
        objects = self.objects
        if config.scope == "query":
            config = replace(config, detail="partial")
            print(
                "This agent is told of questions, not of objects. What follows is what its graph "
                "says about the objects, in any colour."
            )
            if objects == OBJECTS:
                described = find_objects(read_graph(config.graph), objects)
                objects = tuple(name for name in objects if described[name] is not None)
        if run is not None:
            return config, list(facets_of(run.env)), run.seed
        facets: list[tuple[str, str]] = []
        for name in objects:
            if name in TARGETS:
                colours = tuple(TARGETS[name].colours)
            else:
                graph = read_graph(config.graph)
                colours = _colours_in(
                    graph, config.graph_name(name), config.colour_relation
                )
            if self.colours == "fixed":
                colours = colours[:1]
            facets += product([name], colours)
        return config, facets, 0

    def _run(self) -> ExperimentConfig | None:
        """Return the settings of the run, if the agent is a run folder."""
        folder = Path(self.agent or "")
        if not (folder / "config.json").exists() and folder.parent != Path("zoo"):
            return None
        from knowarm.experiment.zoo import open_run

        return open_run(folder).experiment()

    def _config(self, run: ExperimentConfig | None) -> KnowledgeConfig:
        """Return the settings of the agent, or the given ones."""
        if self.agent is None:
            return self.knowledge
        if run is not None:
            knows = run.knows
        elif self.agent in AGENTS:
            knows = AGENTS[self.agent].knows
        else:
            raise unknown_name("agent (a name or a run folder)", self.agent, AGENTS)
        if self.knowledge != FULL or (run and self.objects != OBJECTS):
            raise UserError(
                f"--agent {self.agent} has its own graph, source and settings: leave out --agent, "
                "or the options of the knowledge and, of a run, the objects."
            )
        if isinstance(knows, NoKnowledge):
            raise UserError(
                f"--agent {self.agent} knows nothing: take another, or leave it out."
            )
        return knows


def short_names(rows: Iterable[Sequence[str]]) -> list[list[str]]:
    """Return rows of a table with the local names of entities and relations."""
    return [list(map(local_name, row)) for row in rows]
