"""The name of a source goes in; something that finds vectors for labels comes out."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.config import KnowledgeConfig
from knowarm.knowledge.graph import KnowledgeGraph
from knowarm.knowledge.labels import label_of
from knowarm.knowledge.sentence import Part
from knowarm.knowledge.vectors.coverage import Coverage
from knowarm.knowledge.vectors.forms import all_forms
from knowarm.knowledge.vectors.glove import read_word_vectors
from knowarm.knowledge.vectors.placebos import PLACEBOS
from knowarm.knowledge.vectors.shipped import SHIPPED, shipped_vectors
from knowarm.knowledge.vectors.source import VectorSource
from knowarm.knowledge.vectors.words import WordSource

KGE_MODELS = ("analogy", "transe", "distmult", "complex", "rotate")
"""Sources that are trained on the graph itself; the same names as knowledge.kge.models.MODELS."""

ENCODER = "sentence-transformers:"
"""Prefix of a sentence encoder's name or path."""


def open_source(
    config: KnowledgeConfig, graph: KnowledgeGraph, parts: Sequence[Part]
) -> VectorSource:
    """Open the source that a config names (of a placebo: the one it matches).

    Args:
        config: source, dim, aliases, on_missing, seed.
        graph: what graph embeddings are trained on.
        parts: the labels that will be asked for; of a vector file only their words are read.

    Raises:
        UserError: there is no such source, or its vectors have another dimension.
    """
    name = config.matches if config.source in PLACEBOS else config.source
    if name in SHIPPED:
        source: VectorSource = WordSource(
            shipped_vectors(name), aliases=config.aliases, on_missing=config.on_missing
        )
    elif name in KGE_MODELS:
        # torch takes a second to import, and only graph embeddings need it
        from knowarm.knowledge.kge.source import embed_graph

        source = embed_graph(name, graph, dim=config.dim, seed=config.seed)
    elif name.startswith(ENCODER):
        from knowarm.knowledge.vectors.encoder import EncoderSource

        source = EncoderSource(name.removeprefix(ENCODER))
    elif name.endswith(".safetensors"):
        from knowarm.knowledge.kge.source import stored_source

        source = stored_source(Path(name), graph)
    elif is_path(name):
        forms = {form for part in parts for form in all_forms(part.label, config.aliases)}
        source = WordSource(
            read_word_vectors(Path(name), forms),
            aliases=config.aliases,
            on_missing=config.on_missing,
        )
    else:
        raise unknown_name("vector source", name, [*SHIPPED, *KGE_MODELS, *PLACEBOS])
    if source.dim != config.dim:
        raise UserError(
            f"{source.name} has {source.dim} numbers a word, but the experiment expects "
            f"{config.dim}. Take vectors of {config.dim} numbers or set --dim {source.dim}."
        )
    return source


def graph_parts(graph: KnowledgeGraph, *, relation_words: bool) -> list[Part]:
    """Return every label of a graph: its entities and, if wanted, its relations."""
    parts = [Part(n, label_of(n, graph.labels), False) for n in graph.entities]
    if relation_words:
        used = graph.relations_used
        parts += [Part(n, label_of(n, graph.labels), True) for n in used]
    return parts


def centre_of(source: VectorSource, parts: Sequence[Part]) -> np.ndarray:
    """Return the mean vector of labels, (D,) float64; labels that are not found do not count."""
    found = []
    for part in parts:
        try:
            found.append(source.find(part, Coverage()).vectors)
        except UserError:
            continue
    vectors = np.concatenate([np.empty((0, source.dim), np.float32), *found])
    return vectors.mean(axis=0, dtype=np.float64) if len(vectors) else np.zeros(source.dim)


def is_path(name: str) -> bool:
    """Whether a source's name means a file."""
    return "/" in name or "\\" in name or Path(name).suffix in {".txt", ".gz", ".zip", ".vec"}
