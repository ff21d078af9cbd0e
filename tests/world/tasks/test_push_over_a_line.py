"""A skill of one file outside the package plays with and without a question of the graph."""

from pathlib import Path

import pytest

import knowarm
from knowarm.cli.main import main
from knowarm.world.agents.scripted import OracleAgent
from knowarm.world.tasks import VARIABLE
from knowarm.world.tasks.skills import SKILLS
from tests.world.tasks.push_over_a_line import Push

ZOO = Path(__file__).parents[3] / "zoo"
SKILL = "tests.world.tasks.push_over_a_line:Push"


def test_the_oracle_pushes_the_object_over_the_line():
    env = knowarm.make("irb120", num_envs=12, task=Push(), image_size=8)
    episodes = knowarm.evaluation_episodes(env.config, 12, 0)
    result = knowarm.play(OracleAgent(env), env, episodes)
    assert result.success.mean() >= 0.7


@pytest.fixture
def unlisted(monkeypatch):
    """Forget the skill afterwards."""
    monkeypatch.setenv(VARIABLE, "")
    yield
    SKILLS.pop("slide", None)


@pytest.mark.slow
@pytest.mark.usefixtures("unlisted")
def test_it_is_asked_for_by_one_command_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    network = ZOO / "irb120-choose-answers-fast" / "perception.safetensors"
    train = ["train", "irb120-choose-answers-seen", "--env.task", SKILL]
    main([*train, "--perception", str(network), "--interim.episodes", "2"])
    (run,) = Path("runs").glob("*/0")
    result = knowarm.evaluate(run, episodes=16, probes=(), write=False)
    assert result.summary["success"] > 0.3  # at the wrong object 0.19
    assert len(set(result.episodes["query"])) > 8
