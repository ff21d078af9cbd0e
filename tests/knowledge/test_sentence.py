import sys
import types

import numpy as np
import pytest

from knowarm.config import from_dict, to_dict
from knowarm.errors import UserError
from knowarm.knowledge import (
    KnowledgeConfig,
    graph_of,
    scene_embedding,
    scene_sentences,
    sentence,
)
from knowarm.knowledge.slots import sentence_parts
from knowarm.knowledge.vectors.source import SentenceEncoder
from tests.knowledge.helpers import KNOWLEDGE

MUG = graph_of(
    [
        ("mug", "hasColor", "light_blue"),
        ("mug", "isMadeOf", "ceramic"),
        ("mug", "isA", "cup"),
    ],
    labels={"cup": "Drinking Cup"},
)


def test_templates_name_relations_by_their_last_part():
    graph = graph_of([("mug", "http://e.org/isMadeOf", "clay")])
    config = KnowledgeConfig(detail="full", templates={"isMadeOf": "made of"})
    assert sentence(graph, config) == "mug made of clay"


def test_the_papers_form():
    said = "mug has color light blue mug is a drinking cup mug is made of ceramic"
    assert sentence(MUG) == said
    kinds = [part.is_relation for part in sentence_parts(MUG)]
    assert kinds == [False, True, False] * 3


def test_options():
    short = KnowledgeConfig(detail="full", relation_words=False)
    assert sentence(MUG, short) == "mug light blue mug drinking cup mug ceramic"
    other = KnowledgeConfig(detail="full", templates={"isMadeOf": "of", "isA": ""})
    assert (
        sentence(MUG, other)
        == "mug has color light blue mug drinking cup mug of ceramic"
    )


def test_options_reach_the_scene(facets):
    config = KnowledgeConfig(
        detail="full", relation_words=True, templates={"hasColor": "painted"}
    )
    said = scene_sentences(config, facets)["red mug"]
    assert "mug painted red" in said
    assert scene_embedding(config, facets).sentences[0] == said


@pytest.mark.parametrize("agent", KNOWLEDGE)
def test_configs_survive_a_run_folder(agent):
    config = KNOWLEDGE[agent]
    assert from_dict(type(config), to_dict(config)) == config


def test_a_sentence_encoder_goes_through_the_same_door(monkeypatch, facets):
    class SentenceTransformer:
        def __init__(self, model, device):
            if model == "absent":
                raise OSError("absent is not a local folder")

        def get_sentence_embedding_dimension(self):
            return 4

        def encode(self, labels, **_):
            return np.array([[len(label), 1, 2, 3] for label in labels], np.float32)

    module = types.ModuleType("sentence_transformers")
    module.SentenceTransformer = SentenceTransformer
    monkeypatch.setitem(sys.modules, "sentence_transformers", module)
    config = KnowledgeConfig(
        detail="partial", source=SentenceEncoder(model="local"), dim=4
    )
    assert scene_embedding(config, facets).dim == 12
    absent = KnowledgeConfig(
        detail="partial", source=SentenceEncoder(model="absent"), dim=4
    )
    with pytest.raises(UserError, match="'absent' cannot be loaded"):
        scene_embedding(absent, facets)
    monkeypatch.setitem(sys.modules, "sentence_transformers", None)
    with pytest.raises(UserError, match="pip install sentence-transformers"):
        scene_embedding(config, facets)
