import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.knowledge import KnowledgeConfig, graph_of, household, scene_embedding
from knowarm.knowledge.kge import KgeConfig
from knowarm.knowledge.kge.models import MODELS, KgeModel
from knowarm.knowledge.kge.train import (
    both_ways,
    filtered_ranks,
    hold_out,
    load_model,
    new_model,
    save_model,
    train,
)
from knowarm.knowledge.vectors.graph_embedding import GraphEmbedding
from tests.knowledge.helpers import KNOWLEDGE


class Fixed(KgeModel):
    """Scores tails by a given table, whatever the head."""

    learning_rate, n3 = 0.1, 0.0

    def __init__(self, scores, relations):
        torch.nn.Module.__init__(self)
        self.relations, self.scores = relations, torch.tensor(scores)

    def init(self, entities, relations, dim, generator):
        raise NotImplementedError

    def query(self, head, relation):
        raise NotImplementedError

    def compare(self, query, tail):
        raise NotImplementedError

    def forward(self, head, relation):
        return self.scores.repeat(len(head), 1).clone()


def test_ranks_by_hand():
    # scores of entities 0..4; the true tail is 2
    model = Fixed([5.0, 4.0, 3.0, 3.0, 1.0], 1)
    triple = np.array([[4, 0, 2]])
    ranks = filtered_ranks(model, triple, triple)
    assert ranks.tolist() == [3.5, 5.0]  # two above and one equal; the head 4 is last
    known = np.array([[4, 0, 2], [4, 0, 0], [4, 0, 3], [1, 0, 0]])
    # 0 and 3 are true too, so only 1 counts
    assert filtered_ranks(model, triple, known)[0] == 2.0
    flat = Fixed([0.0] * 5, 1)
    # The middle, not the first
    assert filtered_ranks(flat, triple, triple).tolist() == [
        3.0,
        3.0,
    ]


def test_both_ways():
    assert both_ways(np.array([[1, 0, 2]]), 5).tolist() == [[1, 0, 2], [2, 5, 1]]


def test_held_out_triples_leave_every_name_in_training():
    triples, held = hold_out(household(), 0.3, seed=1)
    everything = household().triples
    assert len(held) == round(0.3 * len(everything))
    assert len(np.unique(np.concatenate([triples, held]), axis=0)) == len(everything)
    assert set(triples[:, [0, 2]].ravel()) == set(range(len(household().names)))
    assert set(triples[:, 1]) == set(range(len(household().relation_names)))
    again, _ = hold_out(household(), 0.3, seed=1)
    assert (again == triples).all()
    with pytest.raises(
        UserError, match="No triple of 1 can be held out so that every entity"
    ):
        hold_out(graph_of([("a", "r", "b")]), 0.9, 0)
    with pytest.raises(UserError, match=r"must lie between 0 and 1, got 1\.2"):
        hold_out(household(), 1.2, 0)


def sizes(graph):
    return len(graph.names), len(graph.relation_names)


def mean_reciprocal_rank(model, held, graph):
    return (1 / filtered_ranks(model, held, graph.triples)).mean()


def family_graph(size=24):
    """A ring with its symmetric and inverse relations: all that is held out can be inferred."""
    triples = []
    for i in range(size):
        a, b = f"p{i}", f"p{(i + 1) % size}"
        triples += [
            (a, "next", b),
            (b, "previous", a),
            (a, "beside", b),
            (b, "beside", a),
        ]
        triples += [(a, "in", f"room{i % 3}"), (f"room{i % 3}", "holds", a)]
    return graph_of(triples)


def test_drawn_entities_that_are_all_change_nothing():
    graph = family_graph()
    parts = hold_out(graph, 0.2, 0)[0], *sizes(graph)
    config = KgeConfig(model="complex", dim=8, epochs=3)
    every = train(config, *parts).model
    drawn = train(replace(config, negatives=50 * len(graph.names)), *parts).model
    few = train(replace(config, negatives=2), *parts).model
    for name, value in every.state_dict().items():
        assert torch.allclose(value, drawn.state_dict()[name], atol=1e-6)
        assert not torch.allclose(value, few.state_dict()[name], atol=1e-3)


@pytest.mark.parametrize(
    ("name", "negatives"), [*((name, None) for name in MODELS), ("complex", 4)]
)
def test_every_model_learns(name, negatives):
    graph = family_graph()
    triples, held = hold_out(graph, 0.2, 0)
    config = KgeConfig(
        model=name, dim=20, epochs=150, learning_rate=0.02, negatives=negatives
    )
    untrained = mean_reciprocal_rank(new_model(config, *sizes(graph)), held, graph)
    done = train(config, triples, *sizes(graph), valid=held)
    trained = mean_reciprocal_rank(done.model, held, graph)
    assert untrained < 0.3
    assert trained > untrained + 0.3
    assert done.losses[-1] < done.losses[0]
    assert max(mrr for _, mrr in done.valid_mrr) == pytest.approx(trained)


def test_one_step_on_all_queries_has_the_gradient_of_all_triples():
    """Queries with several answers weigh by their answers, as triple by triple."""
    triples = np.array([[0, 0, 1], [0, 0, 2], [0, 0, 3], [1, 1, 3], [2, 1, 0]])
    config = KgeConfig(model="complex", dim=8, epochs=1, batch_size=100, n3=0.2)
    done = train(config, triples, 4, 2)
    model = new_model(config, 4, 2)
    head, relation, tail = torch.from_numpy(both_ways(triples, 2)).T
    loss = torch.nn.functional.cross_entropy(model(head, relation), tail)
    (loss + 0.2 * model.penalty(head, relation, tail)).backward()
    torch.optim.Adam(model.parameters(), lr=model.learning_rate).step()
    for name, value in model.state_dict().items():
        torch.testing.assert_close(done.model.state_dict()[name], value)


def test_early_stopping_keeps_the_best():
    graph = family_graph()
    config = KgeConfig(model="complex", dim=8, epochs=400, evaluate_every=5, patience=2)
    triples, held = hold_out(graph, 0.1, 0)
    done = train(config, triples, *sizes(graph), valid=held)
    assert done.epochs < 400
    assert done.epochs == done.best_epoch + 10
    assert dict(done.valid_mrr)[done.best_epoch] == max(
        mrr for _, mrr in done.valid_mrr
    )


def test_the_seed_gives_the_bytes():
    triples = family_graph().triples

    def vectors(seed):
        config = KgeConfig(dim=8, epochs=3, seed=seed)
        return train(config, triples, 27, 5).model.entity.detach().numpy()

    assert (vectors(1) == vectors(1)).all()
    assert (vectors(1) != vectors(2)).any()


def test_threads_are_given_back():
    before = torch.get_num_threads()
    with pytest.raises(UserError):
        train(KgeConfig(model="none"), family_graph().triples, 27, 5)
    train(KgeConfig(dim=8, epochs=1), family_graph().triples, 27, 5)
    assert torch.get_num_threads() == before
    with pytest.raises(UserError, match="no triple to train on"):
        train(KgeConfig(), np.empty((0, 3), np.int64), 3, 1)


def test_a_stored_model_is_the_same_and_serves_as_vectors(tmp_path, facets):
    graph = household()
    config = KgeConfig(model="complex", dim=12, epochs=2)
    done = train(config, graph.triples, len(graph.names), len(graph.relation_names))
    path = tmp_path / "complex.safetensors"
    save_model(done.model, config, graph, path)
    stored = load_model(path)
    assert stored.config == config
    assert stored.entities == tuple(graph.names)
    assert torch.equal(stored.model.relation, done.model.relation)
    knowledge = KnowledgeConfig(
        detail="full", source=GraphEmbedding(file=str(path)), dim=12
    )
    embedding = scene_embedding(knowledge, facets)
    assert embedding.dim == 72
    assert embedding.coverage.describe()["by_kind"] == {"entity": 50}


def test_what_is_no_stored_model(tmp_path, facets):
    with pytest.raises(UserError, match="no model file"):
        load_model(tmp_path / "none.safetensors")
    cut = tmp_path / "cut.safetensors"
    cut.write_bytes(b"\x10\0\0\0\0\0\0\0{")
    with pytest.raises(UserError, match="is damaged or of another format"):
        load_model(cut)
    from knowarm.knowledge.vectors.words import SHIPPED

    with pytest.raises(UserError, match="holds no graph embedding of KnowArm"):
        load_model(SHIPPED["wordnet-gloss-50"])
    other = tmp_path / "other.safetensors"
    graph = family_graph()
    config = KgeConfig(dim=50)
    save_model(new_model(config, len(graph.names), 5), config, graph, other)
    with pytest.raises(UserError, match=r"has no vector for 169 of the graph's names"):
        scene_embedding(
            KnowledgeConfig(detail="full", source=GraphEmbedding(file=str(other))),
            facets,
        )


def test_analogy_goes_through_the_same_door(facets):
    embedding = scene_embedding(KNOWLEDGE["analogy"], facets)
    assert embedding.dim == 300
    json.dumps(to_dict(embedding.describe()))


@pytest.mark.parametrize("name", list(MODELS))
def test_a_training_that_diverges_is_refused(name):
    graph = family_graph()
    triples, held = hold_out(graph, 0.1, 0)
    config = KgeConfig(model=name, dim=8, epochs=10)
    vars(config)["learning_rate"] = 1e37  # no config of this size is accepted
    for valid in (None, held):
        with pytest.raises(UserError, match=r"diverged.*Lower learning_rate"):
            train(config, triples, *sizes(graph), valid=valid)
    model = new_model(config, *sizes(graph))
    model.entity.data[0] = float("nan")
    with pytest.raises(UserError, match="non-finite score"):
        filtered_ranks(model, held, graph.triples)


@pytest.mark.parametrize(
    ("field", "value"),
    [("seed", -1), ("n3", float("nan")), ("n3", -1.0), ("learning_rate", 0.0)]
    + [(name, 0) for name in ("dim", "epochs", "batch_size", "patience", "threads")]
    + [("evaluate_every", 0)],
)
def test_numbers_of_the_config_are_checked(field, value):
    with pytest.raises(UserError, match=rf"{field} must"):
        KgeConfig(**{field: value})


def test_shares_below_one_triple_are_named():
    with pytest.raises(
        UserError, match=r"No triple of 4 can be held out by a share below one"
    ):
        hold_out(graph_of([(h, "r", t) for h in "ab" for t in "cd"]), 0.01, 0)
