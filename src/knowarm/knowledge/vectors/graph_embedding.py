"""Graph embeddings as a vector source: trained on the graph itself, or read from a file."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np

from knowarm.arrays import Floats
from knowarm.errors import UserError
from knowarm.knowledge.formats import SHIPPED, shipped_graph
from knowarm.knowledge.graph.graph import Ids, KnowledgeGraph
from knowarm.knowledge.kge import KgeConfig
from knowarm.knowledge.vectors.source import (
    Coverage,
    Found,
    Request,
    SentencePart,
    Vectors,
    VectorSource,
)

EMBED_EPOCHS = 100
"""Epochs when all triples are used for training and none is left for early stopping."""


@dataclass(frozen=True, kw_only=True)
class GraphEmbedding(VectorSource):
    """One vector per entity and relation."""

    kind: Literal["graph"] = "graph"
    """Tells this source from the others in a file."""
    model: str = "analogy"
    """Model that is trained on the graph: analogy or complex."""
    file: str | None = None
    """Path of a .safetensors file of a fitted model, read instead of training."""

    @property
    def short_name(self) -> str:
        """Model or path of the file."""
        return self.file or self.model

    def open(self, request: Request) -> "EntityLookup":
        """Train the model on the graph, or read it."""
        graph = request.graph
        if self.file is not None:
            return stored_lookup(Path(self.file), graph)
        for name in SHIPPED:
            if graph is shipped_graph(name):
                return _embed_shipped(name, self.model, request.dim, request.seed)
        return embed_graph(self.model, graph, dim=request.dim, seed=request.seed)


class EntityLookup:
    """Finds entities and relations by name among trained vectors."""

    def __init__(
        self,
        name: str,
        graph: KnowledgeGraph,
        entities: Vectors,
        relations: Vectors,
    ) -> None:
        """Take vectors (E, D) and (R, D) float32 in the order of the graph's names."""
        self.name = name
        self.dim = int(entities.shape[1])
        self.graph = graph
        self.entities = entities
        self.relations = relations
        ends = np.concatenate([graph.heads, graph.tails])
        self.entity_shares = _shares(ends, len(entities))
        self.relation_shares = _shares(graph.relations, len(relations))

    def find(self, part: SentencePart, coverage: Coverage) -> Found:
        """Return the vector of an entity or relation; its frequency is its share of triples."""
        coverage.how[part.label] = "entity"
        if part.is_relation:
            row = [self.graph.relation_id(part.name)]
            return Found(self.relations[row], self.relation_shares[row])
        row = [self.graph.entity_id(part.name)]
        return Found(self.entities[row], self.entity_shares[row])


def _shares(ids: Ids, size: int) -> Floats:
    """Return how often each id below a size occurs, as a share of all, (size,)."""
    return np.bincount(ids, minlength=size) / max(len(ids), 1)


def embed_graph(
    model: str, graph: KnowledgeGraph, *, dim: int, seed: int
) -> EntityLookup:
    """Train a model on all triples of a graph."""
    from knowarm.knowledge.kge.train import train  # torch takes a second to import

    config = KgeConfig(model=model, dim=dim, seed=seed, epochs=EMBED_EPOCHS)
    relations = len(graph.relation_names)
    fitted = train(config, graph.triples, len(graph.names), relations).model
    entity_vectors = fitted.entity.detach().numpy()
    relation_vectors = fitted.relation.detach().numpy()[:relations]
    return EntityLookup(model, graph, entity_vectors, relation_vectors)


def stored_lookup(path: Path, graph: KnowledgeGraph) -> EntityLookup:
    """Read the vectors of a model that `kge.train.save_model` wrote."""
    from knowarm.knowledge.kge.train import load_model  # torch takes a second to import

    _, model, entities, relations = load_model(path)
    entity_rows = _rows(path, "entity", entities, graph.names)
    relation_rows = _rows(path, "relation", relations, graph.relation_names)
    entity_vectors = model.entity.detach().numpy()[entity_rows]
    relation_vectors = model.relation.detach().numpy()[relation_rows]
    return EntityLookup(path.name, graph, entity_vectors, relation_vectors)


def _rows(
    path: Path, kind: str, stored: Sequence[str], names: Sequence[str]
) -> list[int]:
    """Return the row of each of the graph's names among those of a file."""
    rows = {name: row for row, name in enumerate(stored)}
    missing = [name for name in names if name not in rows]
    if missing:
        raise UserError(
            f"{path} has no vector for {len(missing)} of the graph's names, first the {kind} "
            f"{missing[0]!r}. Fit the model on this graph."
        )
    return [rows[name] for name in names]


@cache
def _embed_shipped(name: str, model: str, dim: int, seed: int) -> EntityLookup:
    """Train on a shipped graph, once per process."""
    return embed_graph(model, shipped_graph(name), dim=dim, seed=seed)
