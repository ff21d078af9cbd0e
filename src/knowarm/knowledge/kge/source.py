"""A graph goes in; a source that gives every entity and relation its trained vector comes out."""

from functools import cache
from pathlib import Path

import numpy as np

from knowarm.errors import UserError
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.household import household
from knowarm.knowledge.kge.config import KgeConfig
from knowarm.knowledge.kge.split import all_triples
from knowarm.knowledge.kge.store import load_model
from knowarm.knowledge.kge.train import train
from knowarm.knowledge.sentence import Part
from knowarm.knowledge.vectors.coverage import Coverage
from knowarm.knowledge.vectors.source import Found

EMBED_EPOCHS = 100
"""Epochs when all triples are trained on and none is left to stop by."""


class EntitySource:
    """Finds entities and relations by name among trained vectors."""

    def __init__(
        self, name: str, graph: KnowledgeGraph, entities: np.ndarray, relations: np.ndarray
    ) -> None:
        """Make a source of vectors (E, D) and (R, D) in the order of the graph's names."""
        self.name = name
        self.dim = int(entities.shape[1])
        self.graph = graph
        self.entities, self.relations = entities, relations
        ends = np.concatenate([graph.heads, graph.tails])
        self.entity_shares = np.bincount(ends, minlength=len(entities)) / max(len(ends), 1)
        uses = np.bincount(graph.relations, minlength=len(relations))
        self.relation_shares = uses / max(len(graph), 1)

    def find(self, part: Part, coverage: Coverage) -> Found:
        """Return the vector of an entity or relation; its frequency is its share of triples."""
        coverage.how[part.label] = "entity"
        if part.is_relation:
            row = self.graph.relation_id(part.name)
            return Found(self.relations[row : row + 1], self.relation_shares[row : row + 1])
        row = self.graph.entity_id(part.name)
        return Found(self.entities[row : row + 1], self.entity_shares[row : row + 1])


def embed_graph(model: str, graph: KnowledgeGraph, *, dim: int, seed: int) -> EntitySource:
    """Train a model on all triples of a graph."""
    if graph is household():
        return _embed_household(model, dim, seed)
    return _embed(model, graph, dim, seed)


def stored_source(path: Path, graph: KnowledgeGraph) -> EntitySource:
    """Take the vectors of a model that `knowarm knowledge fit --out` wrote.

    Raises:
        UserError: the model does not know an entity or relation of the graph.
    """
    stored = load_model(path)
    vectors = {
        "entity": (stored.entities, stored.model.entity, graph.names),
        "relation": (stored.relations, stored.model.relation_vectors(), graph.relation_names),
    }
    tables = []
    for kind, (known, matrix, names) in vectors.items():
        row = {name: i for i, name in enumerate(known)}
        missing = [name for name in names if name not in row]
        if missing:
            raise UserError(
                f"{path} has no vector for {len(missing)} of the graph's names, first the {kind} "
                f"{missing[0]!r}. Fit the model on this graph."
            )
        tables.append(matrix.detach().numpy()[[row[name] for name in names]])
    return EntitySource(path.name, graph, tables[0], tables[1])


@cache
def _embed_household(model: str, dim: int, seed: int) -> EntitySource:
    """Train on the shipped graph, once a process."""
    return _embed(model, household(), dim, seed)


def _embed(model: str, graph: KnowledgeGraph, dim: int, seed: int) -> EntitySource:
    config = KgeConfig(model=model, dim=dim, seed=seed, epochs=EMBED_EPOCHS)
    relations = len(graph.relation_names)
    done = train(config, all_triples(graph), len(graph.names), relations)
    vectors = done.model.relation_vectors().detach().numpy()[:relations]
    return EntitySource(model, graph, done.model.entity.detach().numpy(), vectors)
