"""Registered controls: equal to their subjects in everything but the content of the vector."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from knowarm.errors import UserError
from knowarm.experiment.agents import AGENTS, controls_of
from knowarm.experiment.names import experiment_config, experiment_names
from knowarm.knowledge import query_embedding, scene_embedding
from knowarm.policy import Policy, PolicyShape
from knowarm.policy.config import FUSIONS
from knowarm.questions import Query
from tests.tiny import FACETS


def parameters(agent: str, facets: list[tuple[str, str]]) -> dict[str, int]:
    embedding = scene_embedding(AGENTS[agent].knows, facets)
    slots = embedding.dim // embedding.slot_dim
    shape = PolicyShape(joints=6, knowledge_dim=embedding.dim, knowledge_slots=slots)
    with torch.device("meta"):
        return Policy(AGENTS[agent].policy, shape).parameter_counts()


@pytest.mark.parametrize("facets", [FACETS[::2], FACETS], ids=["fixed", "randomized"])
@pytest.mark.parametrize(
    ("subject", "capacity", "content"),
    [
        ("full", ["zeros", "wide"], ["random", "shuffled", "onehot", "wrong-object"]),
        ("full+", ["zeros", "wide"], ["random+", "shuffled+", "onehot+"]),
        (
            "target",
            ["target-zeros"],
            ["target-random", "target-shuffled", "target-onehot"],
        ),
        (
            "target+",
            ["target-zeros"],
            ["target-random+", "target-shuffled+", "target-onehot+"],
        ),
    ],
)
def test_controls_have_the_scope_width_norm_and_parameters_of_their_subject(
    subject, capacity, content, facets
):
    assert controls_of(subject, "capacity_control") == capacity
    assert controls_of(subject, "content_control") == content
    real = scene_embedding(AGENTS[subject].knows, facets)
    counts = parameters(subject, facets)
    for name in capacity + content:
        control = scene_embedding(AGENTS[name].knows, facets)
        assert (control.scope, control.dim, control.slots) == (
            real.scope,
            real.dim,
            real.slots,
        )
        others = parameters(name, facets)
        assert others["image"] == counts["image"]
        assert others["total"] == pytest.approx(counts["total"], rel=0.01)
        assert name == "wide" or others == counts
    lengths = np.linalg.norm(real.matrix, axis=1)
    for name in content:
        control = scene_embedding(AGENTS[name].knows, facets)
        assert np.linalg.norm(control.matrix, axis=1) == pytest.approx(
            lengths, rel=1e-5
        ), name
        assert not np.allclose(control.matrix, real.matrix, atol=1e-3)
        assert len(np.unique(control.matrix, axis=0)) == len(facets)


QUERIES = [
    Query.of(("usedFor", "drinking")),
    Query.of(("hasColor", "blue")),
    Query.of(("contains", "tea"), ("hasColor", "red")),
]


@pytest.mark.parametrize(
    ("subject", "content"),
    [
        ("subgraph", ["query-onehot", "query-random", "subgraph-shuffled"]),
        ("query-words", ["query-onehot", "query-random"]),
        pytest.param(
            "query-analogy",
            ["query-onehot", "query-random"],
            marks=pytest.mark.slow(28),
        ),
    ],
)
def test_controls_of_knowledge_of_the_query(subject, content):
    assert controls_of(subject, "capacity_control") == ["query-zeros"]
    assert controls_of(subject, "content_control") == content
    assert AGENTS[subject].role == "knowledge"
    real = query_embedding(AGENTS[subject].knows, QUERIES)
    for name in ["query-zeros", *content]:
        control = query_embedding(AGENTS[name].knows, QUERIES)
        assert (control.dim, control.slots) == (real.dim, real.slots)
        assert AGENTS[name].knows.kind == AGENTS[subject].knows.kind
        assert AGENTS[name].policy == AGENTS[subject].policy
        if name in content:
            assert control.norm == pytest.approx(real.norm, rel=1e-5)
            assert not np.allclose(control.matrix, real.matrix, atol=1e-3)


def test_agents_with_knowledge_of_a_query_are_not_offered_for_reaching():
    told = [
        name for name in experiment_names() if "subgraph" in name or "query" in name
    ]
    assert told
    assert all(name.split("-")[1] in ("choose", "purpose", "families") for name in told)
    with pytest.raises(
        UserError, match="'subgraph' has no experiment of the task 'reach'"
    ):
        experiment_config("irb120-subgraph-ppo")
    with pytest.raises(UserError, match="describes nothing in the task 'reach'"):
        experiment_config("irb120-full-ppo", knows={"kind": "query", "detail": "full"})


@pytest.mark.parametrize(
    ("subject", "capacity", "content"),
    [
        ("answers", [], ["answers-shuffled"]),
        ("subgraph-similarity", [], []),
        ("mine", [], []),
    ],
)
def test_controls_of_agents_with_a_network_or_of_the_user(subject, capacity, content):
    assert controls_of(subject, "capacity_control") == capacity
    assert controls_of(subject, "content_control") == content


def test_agents_of_the_fusions_of_a_query_differ_in_nothing_else():
    agents = [each for name, each in AGENTS.items() if name.startswith("subgraph-")]
    fused = [agent for agent in agents if agent.knows.grounding is None]
    assert {agent.policy.fusion for agent in fused} == {*FUSIONS} - {"none", "critic"}
    assert (
        len({repr((each.knows, replace(each.policy, fusion="none"))) for each in fused})
        == 1
    )
