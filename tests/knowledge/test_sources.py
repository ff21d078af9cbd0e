"""Sources: configs by kind, short names, and a new embedding in one entry."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pytest

from knowarm.config import from_dict, to_dict
from knowarm.errors import UserError
from knowarm.knowledge import FULL, SOURCES, KnowledgeConfig, scene_embedding
from knowarm.knowledge.vectors import source_named
from knowarm.knowledge.vectors.graph_embedding import GraphEmbedding
from knowarm.knowledge.vectors.placebos import OneHot, Placebo, RandomVectors, Zeros
from knowarm.knowledge.vectors.source import Found, SentenceEncoder, VectorSource
from knowarm.knowledge.vectors.words import WordVectors


@pytest.mark.parametrize("kind", SOURCES)
def test_kinds_are_the_keys_of_the_registry(kind):
    assert SOURCES[kind].__dataclass_fields__["kind"].default == kind


@pytest.mark.parametrize(
    ("name", "source"),
    [
        ("wordnet-gloss-50", WordVectors()),
        ("glove-6b-50", WordVectors(name="glove-6b-50")),
        ("vectors/glove.6B.50d.txt", WordVectors(file="vectors/glove.6B.50d.txt")),
        ("v.zip", WordVectors(file="v.zip")),
        ("complex", GraphEmbedding(model="complex")),
        ("fits/m.safetensors", GraphEmbedding(file="fits/m.safetensors")),
        ("sentence-transformers:/models/x", SentenceEncoder(model="/models/x")),
        ("zeros", Zeros()),
        ("random:analogy", RandomVectors(matches=GraphEmbedding())),
    ],
)
def test_short_names(name, source):
    assert source_named(name) == source


def test_wrong_values_are_refused():
    stored = to_dict(FULL)
    with pytest.raises(UserError, match=r"source\.kind 'word'.*'words'"):
        from_dict(KnowledgeConfig, {**stored, "source": {"kind": "word"}})
    with pytest.raises(UserError, match=r"field of source 'nam'.*'name'"):
        from_dict(KnowledgeConfig, {**stored, "source": {"kind": "words", "nam": "x"}})
    with pytest.raises(
        UserError, match="source must hold the fields of one of WordVectors"
    ):
        from_dict(KnowledgeConfig, {**stored, "source": "zeros"})
    with pytest.raises(UserError, match="matches must be a real source"):
        OneHot(matches=RandomVectors())
    with pytest.raises(UserError, match=r"vector source 'analog'.*'analogy'"):
        source_named("analog")
    with pytest.raises(UserError, match="needs a value for model"):
        source_named("sentence-transformers")


@dataclass(frozen=True, kw_only=True)
class Lengths(VectorSource):
    """A toy embedding: the length of the label, then zeros."""

    kind: Literal["lengths"] = "lengths"
    scale: float = 1.0

    def open(self, request):
        scale = self.scale

        class Lookup:
            name, dim = "lengths", request.dim

            def find(self, part, coverage):
                coverage.how[part.label] = "word"
                vector = np.zeros((1, self.dim), np.float32)
                vector[0, 0] = scale * len(part.label)
                return Found(vector, np.zeros(1))

        return Lookup()


def test_a_new_embedding_is_one_class_and_one_entry(monkeypatch, facets):
    monkeypatch.setitem(SOURCES, "lengths", Lengths)
    config = KnowledgeConfig(detail="full", source=Lengths(scale=2.0), dim=8)
    embedding = scene_embedding(from_dict(KnowledgeConfig, to_dict(config)), facets)
    assert embedding.config == config
    assert embedding.matrix.shape == (6, 8)
    assert embedding.matrix[:, 0].min() > 2.0
    assert source_named("lengths") == Lengths()
    placebo = replace(config, source=RandomVectors(matches=Lengths()))
    assert scene_embedding(placebo, facets).matrix.shape == (6, 8)


@dataclass(frozen=True, kw_only=True)
class NextFacet(Placebo):
    """A toy placebo: every slot describes the next one's facet."""

    kind: Literal["next-facet"] = "next-facet"

    def change_facets(self, facets, graph, colour_relation, seed):
        return [*facets[1:], facets[0]]


def test_a_new_placebo_changes_one_step_and_copies_the_real_lengths(facets):
    real = scene_embedding(FULL, facets)
    false = scene_embedding(replace(FULL, source=NextFacet()), facets)
    assert false.slots == real.slots
    assert false.sentences == (*real.sentences[1:], real.sentences[0])
    lengths = np.linalg.norm(real.matrix, axis=1)
    np.testing.assert_allclose(np.linalg.norm(false.matrix, axis=1), lengths, rtol=1e-5)
