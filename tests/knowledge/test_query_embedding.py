from dataclasses import replace

import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.knowledge import (
    QUERY,
    KnowledgeConfig,
    graph_of,
    query_embedding,
    write_graph,
)
from knowarm.knowledge.formats import shipped_graph
from knowarm.knowledge.queries.queries import parse_query
from knowarm.knowledge.queries.splits import query_splits
from knowarm.knowledge.vectors import GraphEmbedding
from knowarm.knowledge.vectors.placebos import (
    Learned,
    OneHot,
    RandomVectors,
    ShuffledGraph,
    WrongObject,
    Zeros,
)
from knowarm.questions import Condition, Query
from tests.knowledge.choice import CHOICE

ASKED = [
    parse_query(text)
    for text in (
        "usedFor drinking",
        "hasColor blue",
        "usedFor drinking and hasColor blue",
        "contains tea",
    )
]
PAPER = KnowledgeConfig(detail="full", graph="objects", direction="both")


def test_a_row_holds_facts_first_and_colours_last():
    table = query_embedding(QUERY, ASKED).table(ASKED)
    drinking, blue, both, _ = table.reshape(4, 2, 50)
    assert table.shape == (4, 100)
    assert table.dtype == np.float32
    assert not drinking[1].any()
    assert not blue[0].any()
    assert (both[0] == drinking[0]).all()
    assert (both[1] == blue[1]).all()


def test_a_query_that_was_not_embedded_is_named():
    with pytest.raises(
        UserError, match="No slot describes contains tea: embed the queries first"
    ):
        query_embedding(QUERY, ASKED[:3]).table(ASKED)


def test_a_slot_says_what_the_graph_links_to_the_value():
    embedding = query_embedding(PAPER, ASKED)
    drinking = embedding.sentences[
        embedding.slots.index(Condition("usedFor", "drinking"))
    ]
    assert drinking.startswith(
        "used for drinking bottle used for drinking can used for drinking"
    )
    assert "drinking related to tea" in drinking
    assert "rim related to drinking" in drinking
    assert embedding.coverage.share == 1.0
    words = query_embedding(replace(PAPER, hops=0), ASKED)
    assert words.sentences[0] == "used for drinking"
    assert not embedding.constant
    assert not embedding.privileged
    assert list(embedding.describe().slots) == [c.name for c in embedding.slots]


def test_conditions_of_the_shipped_graph_can_be_told_apart():
    queries = query_splits(shipped_graph("objects"), CHOICE).train.queries
    for config in (QUERY, replace(QUERY, hops=0, colour_share=None)):
        matrix = query_embedding(config, queries).matrix.astype(float)
        cosine = matrix @ matrix.T
        assert np.diag(cosine) == pytest.approx(1, abs=1e-5)
        assert (cosine - 2 * np.eye(len(cosine))).max() < 0.96


@pytest.mark.parametrize("source", [OneHot(), RandomVectors(), ShuffledGraph()])
def test_placebos_have_the_length_of_the_real_slots(source):
    real = query_embedding(PAPER, ASKED)
    control = query_embedding(replace(PAPER, source=source), ASKED)
    lengths = [np.linalg.norm(each.matrix, axis=1) for each in (real, control)]
    assert lengths[1] == pytest.approx(lengths[0], rel=1e-5)
    assert control.dim == real.dim
    assert not np.allclose(control.matrix, real.matrix, atol=1e-3)


@pytest.mark.parametrize("source", [RandomVectors(), ShuffledGraph()])
def test_what_is_drawn_is_drawn_per_training_seed(source):
    config = replace(QUERY, source=source)
    one, same, other = (
        query_embedding(config, ASKED, run_seed=seed) for seed in (1, 1, 2)
    )
    assert (one.matrix == same.matrix).all()
    assert not np.allclose(one.matrix, other.matrix, atol=1e-3)


def test_other_sources():
    assert not query_embedding(replace(QUERY, source=Zeros()), ASKED).matrix.any()
    learned = query_embedding(replace(QUERY, source=Learned()), ASKED)
    assert (learned.matrix[:, :3] == np.eye(3)).all()
    trained = query_embedding(
        replace(QUERY, hops=0, source=GraphEmbedding(model="complex")), ASKED
    )
    assert trained.coverage.how["drinking"] == "entity"
    with pytest.raises(UserError, match=r"'wrong-object' describes other objects"):
        query_embedding(replace(QUERY, source=WrongObject()), ASKED)
    with pytest.raises(UserError, match=r"3 slots do not fit a one-hot of 2"):
        query_embedding(replace(QUERY, dim=2, source=Learned()), ASKED)


def test_an_edited_graph_changes_the_vectors_of_what_was_edited_only():
    splits = query_splits(shipped_graph("objects"), CHOICE)
    train, test = splits.train.queries, splits.test("S5")
    before = query_embedding(QUERY, train)
    after = query_embedding(QUERY, test.queries, graph=splits.edited, trained_on=train)
    moved = np.linalg.norm(before.matrix - after.matrix[: len(before.matrix)], axis=1)
    asked = {
        query.conditions[0]
        for query, row in zip(test.queries, test.askable, strict=True)
        if row.any() and len(query.conditions) == 1
    }
    for slot, distance in zip(before.slots, moved, strict=True):
        assert (distance > 0.1) == (slot in asked), slot


def test_codes_keep_their_numbers_when_an_edited_graph_adds_queries():
    config = replace(QUERY, source=OneHot())
    more = [parse_query("usedFor sorting screws"), parse_query("contains tea")]
    before = query_embedding(config, ASKED).table(ASKED)
    after = query_embedding(config, more, trained_on=ASKED).table(more)
    assert (after[1] == before[3]).all()
    assert not any((after[0] == row).all() for row in before)


def test_a_graph_of_the_user(tmp_path):
    graph = graph_of(
        [("mug", "used for", "drinking"), ("screwdriver", "used for", "repairs")]
    )
    write_graph(graph, tmp_path / "mine.csv")
    config = replace(PAPER, graph=str(tmp_path / "mine.csv"))
    asked = [Query.of(("used for", "drinking")), Query.of(("hasColor", "blue"))]
    embedding = query_embedding(config, asked)
    assert embedding.sentences == (
        "used for drinking mug used for drinking",
        "has color blue",
    )
    with pytest.raises(
        UserError, match=r"describes none of the 2 conditions.*'contains tea'"
    ):
        query_embedding(config, [Query.of(("contains", "tea")), asked[1]])


def test_one_condition_alone_can_be_described():
    query = Query.of(("usedFor", "drinking"))
    assert np.linalg.norm(query_embedding(QUERY, [query]).vector) == pytest.approx(1.0)
