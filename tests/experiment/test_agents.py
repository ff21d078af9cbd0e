"""Registered controls: equal to their subjects in everything but the content of the vector."""

import numpy as np
import pytest
import torch

from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.experiment.agents import AGENTS, controls_of
from knowarm.experiment.build import build, load_agent
from knowarm.experiment.registry import experiment_config, experiment_names
from knowarm.experiment.run_folder import RunFolder
from knowarm.knowledge import query_embedding, scene_embedding
from knowarm.learn.checkpoint import Checkpoint, CheckpointStore, policy_arrays
from knowarm.policy import Policy, PolicyConfig, PolicyShape

FACETS = [
    ("mug", "red"),
    ("mug", "blue"),
    ("bottle", "yellow"),
    ("bottle", "purple"),
    ("cereal_box", "brown"),
    ("cereal_box", "light_blue"),
]


def parameters(agent: str, facets: list[tuple[str, str]]) -> dict[str, int]:
    embedding = scene_embedding(AGENTS[agent].knowledge, facets)
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
        ("target", ["target-zeros"], ["target-random", "target-shuffled", "target-onehot"]),
        ("target+", ["target-zeros"], ["target-random+", "target-shuffled+", "target-onehot+"]),
    ],
)
def test_controls_have_the_scope_width_norm_and_parameters_of_their_subject(
    subject, capacity, content, facets
):
    assert controls_of(subject, "capacity_control") == capacity
    assert controls_of(subject, "content_control") == content
    real = scene_embedding(AGENTS[subject].knowledge, facets)
    counts = parameters(subject, facets)
    for name in capacity + content:
        control = scene_embedding(AGENTS[name].knowledge, facets)
        assert (control.scope, control.dim, control.slots) == (real.scope, real.dim, real.slots)
        others = parameters(name, facets)
        assert others["image"] == counts["image"]
        assert others["total"] == pytest.approx(counts["total"], rel=0.01)
        assert name == "wide" or others == counts
    lengths = np.linalg.norm(real.matrix, axis=1)
    for name in content:
        control = scene_embedding(AGENTS[name].knowledge, facets)
        assert np.linalg.norm(control.matrix, axis=1) == pytest.approx(lengths, rel=1e-5), name
        assert not np.allclose(control.matrix, real.matrix, atol=1e-3)
        assert len(np.unique(control.matrix, axis=0)) == len(facets)


QUERIES = ["usedFor drinking", "hasColor blue", "contains tea and hasColor red"]


@pytest.mark.parametrize(
    ("subject", "content"),
    [
        ("subgraph", ["query-onehot", "query-random", "subgraph-shuffled"]),
        ("query-words", ["query-onehot", "query-random"]),
        ("query-analogy", ["query-onehot", "query-random"]),
    ],
)
def test_controls_of_what_is_told_about_the_query(subject, content):
    assert controls_of(subject, "capacity_control") == ["query-zeros"]
    assert controls_of(subject, "content_control") == content
    assert AGENTS[subject].role == "knowledge"
    real = query_embedding(AGENTS[subject].knowledge, QUERIES)
    for name in ["query-zeros", *content]:
        control = query_embedding(AGENTS[name].knowledge, QUERIES)
        assert (control.scope, control.dim, control.slots) == ("query", real.dim, real.slots)
        assert AGENTS[name].policy == AGENTS[subject].policy
        if name in content:
            assert control.norm == pytest.approx(real.norm, rel=1e-5)
            assert not np.allclose(control.matrix, real.matrix, atol=1e-3)


def test_agents_that_are_told_a_query_are_not_offered_for_reaching():
    told = [name for name in experiment_names() if "subgraph" in name or "query" in name]
    assert told
    assert all("-choose-" in name for name in told)
    with pytest.raises(UserError, match="Unknown agent of the experiment 'subgraph'"):
        experiment_config("irb120-subgraph-ppo")
    config = experiment_config("irb120-full-ppo", knowledge={"scope": "query"})
    with pytest.raises(UserError, match="this task asks for nothing"):
        build(config)


def test_an_agent_of_the_user_has_no_registered_controls():
    assert controls_of("mine", "content_control") == []


def test_a_capacity_control_of_an_earlier_version_can_be_loaded(tmp_path):
    """Its run stored only that the network is wide, and its checkpoint has 202 features."""
    config = experiment_config("irb120-wide-ppo")
    parts = build(config)
    trained = Policy(
        PolicyConfig(fusion="none", hidden=278, features=202), parts.policy_shape, seed=5
    )
    folder = RunFolder.create(tmp_path / "run")
    folder.write_json("config.json", {"format": 3, **to_dict(config)})
    choices, shape = to_dict(config.policy), to_dict(parts.policy_shape)
    assert choices["wide"]
    folder.write_json("provenance.json", {"policy": {"config": choices, "shape": shape}})
    folder.write_knowledge(parts.table)
    store = CheckpointStore(folder.checkpoints, {})
    store.save(Checkpoint(policy=policy_arrays(trained), facts={"step": 7}))
    loaded = load_agent(folder.path, which="latest")
    assert loaded.step == 7
    assert loaded.policy.parameter_counts()["total"] == 794_167
    assert torch.equal(loaded.policy.fc.weight, trained.fc.weight)
