"""Cells in which trays stand for places: their tables, and controls of where objects belong."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from knowarm.benchmark.freezing import SEED, freeze
from knowarm.benchmark.policies import entrant
from knowarm.benchmark.rows import read_row, run_suite, with_other_facts
from knowarm.benchmark.suites import CONTROLS, Cell, by_table, parse_suite
from knowarm.errors import UserError
from knowarm.experiment.load import load_agent
from knowarm.experiment.names import experiment_config
from knowarm.perception.solving import SolvingAgent
from knowarm.reading import write_json
from knowarm.world.agents.protocol import Batch
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.skills.guides import JointPath
from knowarm.world.tasks.skills.lift.guide import LiftGuide
from tests.source_tree import ROOT

RUN = str(ROOT / "zoo" / "tiago-choose-sort-answers-seen")


@pytest.fixture(scope="module")
def cell():
    """A few short episodes."""
    env = experiment_config("tiago-choose-sort-answers-seen").env
    env = replace(env, max_episode_steps=4)
    listed = np.zeros((4, 8), np.int64)
    scores = {"oracle": None, "open-loop": None, "chance": 0.25}
    drawn = evaluation_episodes(env, 4, SEED)
    return Cell("tiago-place", env, None, drawn, listed, scores, group="place")


@pytest.fixture(scope="module")
def suite(cell):
    return freeze("own", "small", [cell], training_seeds=1, control_episodes=4)


def test_a_table_is_named_by_its_group(cell, suite):
    tables = by_table([*suite.cells.values(), replace(cell, name="other", group="")])
    assert tables == {
        "place, tiago, randomized colours": ["tiago-place"],
        "tiago, randomized colours": ["other"],
    }
    assert parse_suite(*suite.data).digest == suite.digest


@pytest.mark.slow
def test_where_objects_belong_has_controls_of_its_own(suite, monkeypatch, tmp_path):
    def stand_still(guide, sight):
        """Solve no path: a control of each of ten would take seconds."""
        return JointPath(sight.joints[:, None], 1.0)

    monkeypatch.setattr(LiftGuide, "path", stand_still)
    row = run_suite(suite, [entrant(RUN)], name="seen")
    controls = row["cells"]["tiago-place"]["controls"]
    assert [*controls, "intact graph"] == list(CONTROLS)
    monkeypatch.setattr("knowarm.benchmark.rows.read_suite", lambda name: suite)
    path = tmp_path / "row.json"

    def without(name):
        """Store the row without a control."""
        changed = copy.deepcopy(row)
        del changed["cells"]["tiago-place"]["outcomes"][0][name]
        del changed["cells"]["tiago-place"]["controls"][name]
        for summary in changed["summary"].values():
            del summary["controls"][name]
        write_json(path, changed)

    without("unknown places")  # which only some policies have
    assert read_row(path)["name"] == "seen"
    without("shuffled facts")
    with pytest.raises(UserError, match="lacks, or has, shuffled facts"):
        read_row(path)


def test_facts_are_those_of_other_episodes(cell):
    env = ArmVectorEnv(cell.env, 4)
    env.reset(options={"episodes": cell.episodes})
    batch = Batch.of(env)
    other = with_other_facts(batch)
    assert set(batch.facts) == {"tray_places", "tray_colours"}
    pairs = []
    for told in (batch, other):
        facts = told.facts
        of_trays = np.concatenate([facts["tray_places"], facts["tray_colours"]], axis=1)
        pairs.append(of_trays.tolist())
    assert pairs[0] != pairs[1]
    assert sorted(pairs[0]) == sorted(pairs[1])
    assert other.names.tolist() == batch.names.tolist()


def named(env):
    """Let questions name the destination."""
    skill = replace(env.task.skill, destination="place")
    return replace(env, task=replace(env.task, skill=skill))


@pytest.mark.parametrize("hears", [True, False])
def test_who_is_not_told_the_destination_does_not_know_it(hears):
    trained = load_agent(RUN)
    env = ArmVectorEnv(named(trained.config.env), 2)
    images, _ = env.reset(seed=0)
    agent = SolvingAgent(trained.agent, env.config, guesses=False, hears=hears)
    agent.reset(Batch.of(env))
    agent.act({"image": images, "joint_targets": env.joint_positions})
    assert agent.lacks_place.tolist() == [not hears] * 2
