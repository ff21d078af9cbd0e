"""Recordings for Rerun, read back by Rerun."""

import numpy as np
import pytest
import torch

from knowarm.cli.main import main
from knowarm.experiment.load import load_agent
from knowarm.perception.recognition import known_in_episode
from knowarm.world.agents.protocol import Batch
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from tests.source_tree import ROOT

pytest.importorskip("rerun")


@pytest.mark.slow(8)
def test_an_episode_is_recorded(tmp_path, capsys):
    path = tmp_path / "episode.rrd"
    assert main(["view", "irb120", "--episodes", "2", "--rrd", str(path)]) == 0
    assert str(path) in capsys.readouterr().out
    entities = {str(chunk.entity_path) for chunk in chunks(path)}
    assert sum(name.startswith("/joints/") for name in entities) == 6
    assert entities >= {
        "/camera/policy",
        "/camera/large",
        "/distance",
        "/angle",
        "/goal",
    }
    rows = sum(
        chunk.num_rows
        for chunk in chunks(path)
        if str(chunk.entity_path) == "/distance"
    )
    assert rows > 20
    goals = [
        chunk.to_record_batch()
        for chunk in chunks(path)
        if str(chunk.entity_path) == "/goal"
    ]
    steps = [step for batch in goals for step in batch.column("step").to_pylist()]
    assert steps == [0, 0], "the goal stands where its episode begins"


@pytest.mark.slow(15)
@pytest.mark.parametrize("agent", ["answers", "subgraph"])
def test_what_a_run_knows_is_recorded(tmp_path, agent):
    path, run = tmp_path / "episode.rrd", ROOT / f"zoo/irb120-choose-{agent}-fast"
    assert (
        main(["view", "--agent", str(run), "--episodes", "2", "--rrd", str(path)]) == 0
    )
    for name in ("/knowledge", "/recognition"):
        found = [chunk for chunk in chunks(path) if str(chunk.entity_path) == name]
        assert sum(chunk.num_rows for chunk in found) == 2


def test_the_map_of_recognition_is_largest_where_the_object_is_found():
    trained = load_agent(ROOT / "zoo/irb120-choose-answers-fast")
    env = ArmVectorEnv(trained.config.env, 1)
    episode = evaluation_episodes(trained.config.env, 1, 0)
    images, _ = env.reset(options={"episodes": episode})
    trained.agent.reset(Batch.of(env))
    known = known_in_episode(trained.agent, images[0])
    recognition = trained.agent.recognition
    rows = torch.as_tensor(env.knowledge_input)
    seen = recognition.see(torch.as_tensor(images), recognition.of_rows(rows))
    assert known["recognition"].shape == (16, 16)
    assert known["recognition"].sum() == pytest.approx(1, abs=1e-5)
    assert known["recognition"].argmax() == seen.scores[0].argmax()
    np.testing.assert_array_equal(known["knowledge"], seen.frames[0])


def chunks(path):
    """Read the chunks of a recording."""
    from rerun.chunk import RrdReader

    return list(RrdReader(str(path)).stream().to_chunks())


def test_another_suffix_is_refused(tmp_path, capsys):
    assert main(["view", "irb120", "--rrd", str(tmp_path / "episode.mp4")]) == 2
    assert ".rrd" in capsys.readouterr().err


def test_what_solves_paths_is_written_with_what_its_network_sees(tmp_path, capsys):
    run = ROOT / "zoo/tiago-choose-sort-answers-seen"
    path = tmp_path / "episode.rrd"
    arguments = ["view", "--agent", str(run), "--rrd", str(path), "--episodes", "1"]
    assert main(arguments) == 0
    assert "1 episodes reached" in capsys.readouterr().out
    assert any("recognition" in str(chunk.entity_path) for chunk in chunks(path))
