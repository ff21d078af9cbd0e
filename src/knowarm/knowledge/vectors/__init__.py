"""Vector sources: word vectors, graph embeddings, sentence encoders and placebos, by kind."""

from dataclasses import fields
from pathlib import Path

from knowarm.errors import UserError, unknown_name
from knowarm.knowledge.formats.files import COMPRESSED
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
from knowarm.knowledge.vectors.source import SOURCES, SentenceEncoder, VectorSource
from knowarm.knowledge.vectors.words import SHIPPED, WordVectors

SOURCES |= {
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
# A new source is one class and one line here.


def source_named(name: str) -> VectorSource:
    """Return the source of a short name.

    The name of shipped vectors, the path of word vectors or of a fitted model (.safetensors), a
    graph-embedding model ("analogy"), a kind, or one with its first field ("random:analogy").
    """
    kind, _, value = name.partition(":")
    if name in SHIPPED:
        return WordVectors(name=name)
    if kind in SOURCES:
        return _source_of_kind(SOURCES[kind], kind, value)
    if name.endswith(".safetensors"):
        return GraphEmbedding(file=name)
    if (
        "/" in name
        or "\\" in name
        or Path(name).suffix in (".txt", ".vec", *COMPRESSED)
    ):
        return WordVectors(file=name)
    from knowarm.knowledge.kge.models import MODELS  # torch takes a second to import

    if name in MODELS:
        return GraphEmbedding(model=name)
    if Path(name).is_file():
        return WordVectors(file=name)
    raise unknown_name("vector source", name, [*SHIPPED, *MODELS, *SOURCES])


def _source_of_kind(cls: type[VectorSource], kind: str, value: str) -> VectorSource:
    """Return the source of a kind, with a value of its first field if there is one."""
    if issubclass(cls, Placebo):
        return cls(matches=source_named(value)) if value else cls()
    names = [field.name for field in fields(cls) if field.name != "kind"]
    if value and not names:
        raise UserError(
            f"The source {kind!r} takes no value, got {f'{kind}:{value}'!r}. Give {kind!r}."
        )
    try:
        return cls(**{names[0]: value}) if value else cls()
    except TypeError as error:
        raise UserError(
            f"{kind!r} needs a value for {names[0]}: {kind}:{names[0]}."
        ) from error


__all__ = ["SOURCES", "VectorSource", "source_named"]
