"""Vector sources: word vectors, graph embeddings, sentence encoders and placebos, by kind."""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from knowarm.config import to_dict
from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.vectors.encoder import SentenceEncoder
from knowarm.knowledge.vectors.graph_embedding import GraphEmbedding
from knowarm.knowledge.vectors.placebos import (
    Learned,
    OneHot,
    Placebo,
    RandomVectors,
    ShuffledGraph,
    WrongObject,
    Zeros,
)
from knowarm.knowledge.vectors.source import Source, VectorSource
from knowarm.knowledge.vectors.words import SHIPPED, WordVectors

SOURCES: dict[str, type[Source]] = {
    "words": WordVectors,
    "graph": GraphEmbedding,
    "sentence-transformers": SentenceEncoder,
    "zeros": Zeros,
    "random": RandomVectors,
    "onehot": OneHot,
    "shuffled": ShuffledGraph,
    "wrong-object": WrongObject,
    "learned": Learned,
}
"""Config class of every source by its `kind`. A new source is one class and one line here."""


def source_named(name: str, matches: str = "wordnet-gloss-50") -> Source:
    """Return the source that a short name stands for.

    Short names are those of run format 1: shipped vectors ("wordnet-gloss-50"), the path of a
    file of word vectors or of a fitted graph embedding (.safetensors), a graph-embedding model
    ("analogy"), a kind, or a kind with its first field ("sentence-transformers:PATH").

    Args:
        name: the short name.
        matches: short name of the real source that a placebo copies.

    Raises:
        UserError: the name stands for no source.
    """
    kind, _, value = name.partition(":")
    if name in SHIPPED:
        return WordVectors(name=name)
    if kind in SOURCES:
        cls = SOURCES[kind]
        if issubclass(cls, Placebo):
            return cls(matches=source_named(value or matches))  # type: ignore[arg-type]
        first = next((field.name for field in fields(cls) if field.name != "kind"), None)
        try:
            return cls(**{first: value}) if first and value else cls()
        except TypeError as error:
            raise UserError(f"{name!r} needs a value for {first}: {name}:{first}.") from error
    if name.endswith(".safetensors"):
        return GraphEmbedding(file=name)
    if "/" in name or "\\" in name or Path(name).suffix in (".txt", ".gz", ".zip", ".vec"):
        return WordVectors(file=name)
    from knowarm.knowledge.kge.models import MODELS  # torch takes a second to import

    if name in MODELS:
        return GraphEmbedding(model=name)
    raise unknown_name("vector source", name, [*SHIPPED, *MODELS, *SOURCES])


def migrate_source(values: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the stored values of a `KnowledgeConfig` to the current fields.

    Args:
        values: the stored fields; format 1 holds short names in `source` and `matches`.

    Returns:
        The fields with `source` as a tagged config whose new fields mean what earlier versions
        did; current ones unchanged.
    """
    migrated = dict(values)
    source = values.get("source")
    if isinstance(source, str):
        named = source_named(source, migrated.pop("matches", "wordnet-gloss-50"))
        migrated["source"] = {**to_dict(named), **named.earlier_values}
    elif isinstance(source, Mapping) and source.get("kind") in SOURCES:
        migrated["source"] = {**SOURCES[source["kind"]].earlier_values, **source}
    return migrated


__all__ = ["SOURCES", "Source", "VectorSource", "migrate_source", "source_named"]
