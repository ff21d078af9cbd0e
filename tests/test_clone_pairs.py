"""The arm of a neighbour's architecture: recorded, cloned and tested by minimal pairs."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from knowarm.experiment.names import experiment_config
from knowarm.experiment.summary import Summary, read_table
from knowarm.study.config import read_study
from knowarm.world.agents import Batch
from knowarm.world.config import row_names
from knowarm.world.envs.vector_env import ArmVectorEnv
from scripts import build_pairs, clone_pairs


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(clone_pairs, "EPISODES", 24)
    monkeypatch.setattr(clone_pairs, "EPOCHS", 2)
    monkeypatch.setattr(clone_pairs, "BATCH_SIZE", 64)


def test_a_seed_is_evaluated_once_and_stands_in_the_table(tmp_path, monkeypatch):
    (how,) = read_study("minimal-pairs").evaluations
    clone_pairs.run(0, tmp_path, replace(how, episodes=40))
    (folder,) = build_pairs.evaluations([tmp_path])
    assert Summary.read(folder).agent == "irb120-choose-subgraph-sb3-clone/0"
    episodes = read_table(folder / "episodes.parquet")
    has_pair = episodes["has_pair"]
    assert has_pair.any()
    assert not has_pair.all()
    edited = episodes["new_answer"][has_pair] != episodes["target"][has_pair]
    assert edited.all()

    monkeypatch.setattr(clone_pairs, "record_oracle", None)  # nothing runs again
    clone_pairs.run(0, tmp_path, replace(how, episodes=40))
    build_pairs.collect([tmp_path], tmp_path / "pairs.csv")
    arms = build_pairs.read_arms(tmp_path / "pairs.csv")
    declared = build_pairs.planned([read_study(name) for name in build_pairs.STUDIES])
    assert list(build_pairs.shown(arms, declared)) == [(build_pairs.CLONE, "")]
    assert declared[build_pairs.CLONE, ""] == set(range(20))


def recorded(tmp_path):
    chosen = experiment_config(clone_pairs.INFORMED, seed=0)
    frames = clone_pairs.record_oracle(chosen, tmp_path / "dataset")
    table = chosen.knows.known(chosen.env, 0).table
    scale = np.stack([frames.joints.mean(0), frames.joints.std(0)])
    return chosen, frames, table, scale


def test_a_clone_learns_what_was_recorded_and_reads_image_joints_and_vector(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(clone_pairs, "EPOCHS", 16)
    chosen, frames, table, scale = recorded(tmp_path)
    assert len(frames.images) == len(frames.joints) == len(frames.levels) > 300
    policy = clone_pairs.clone(frames, table, scale, seed=0)
    env = ArmVectorEnv(chosen.env, 8)
    agent = clone_pairs.ClonedAgent(policy, table, env, scale)
    inputs = {
        "image": frames.images,
        "joints": clone_pairs.scaled(frames.joints, scale),
        "knowledge": table[frames.rows],
    }
    levels, _ = policy.predict(inputs, deterministic=True)
    constant = [np.bincount(each).max() for each in frames.levels.T]
    best_constant = sum(constant) / frames.levels.size
    assert np.mean(levels == frames.levels) > best_constant + 0.1

    images, _ = env.reset(seed=0)
    batch = Batch.of(env)
    agent.reset(batch)
    rows = np.linspace(0, len(frames.images) - 1, 8).astype(int)
    tensors = {name: torch.as_tensor(part[rows]) for name, part in inputs.items()}
    logits = partial(scores, policy)
    for name, part in tensors.items():
        other = {**tensors, name: part.flip(0)}
        assert not torch.allclose(logits(tensors), logits(other)), name
    assert agent.act({"image": images}).shape == (8, env.scene.num_joints)
    told = agent.telling([np.zeros_like(table[0])] * len(row_names(chosen.env)))
    told.reset(batch)
    assert not told._vectors.any()
    assert agent._vectors.any()


def scores(policy, inputs):
    """Return the logits of all levels, (n, 7 J)."""
    distributions = policy.get_distribution(inputs).distribution
    return torch.cat([each.logits for each in distributions], 1)


def test_shifted_images_keep_their_size_and_move():
    images = torch.arange(2 * 3 * 8 * 8, dtype=torch.uint8).reshape(2, 3, 8, 8)
    middle = clone_pairs.shifted(images, clone_pairs.SHIFT, clone_pairs.SHIFT)
    assert torch.equal(middle, images.float())
    moved = clone_pairs.shifted(images, 0, clone_pairs.SHIFT)
    assert torch.equal(
        moved[..., clone_pairs.SHIFT :], middle[..., : -clone_pairs.SHIFT]
    )
