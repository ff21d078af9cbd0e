import dataclasses
import json

import pytest

from knowarm.config import from_dict, to_dict
from knowarm.errors import UserError
from knowarm.experiment.agents import AGENTS, controls_of
from knowarm.experiment.names import ExperimentName
from knowarm.study.config import (
    SHIPPED,
    ExperimentGrid,
    StudyConfig,
    controls,
    read_study,
    write_study,
)
from knowarm.study.executor import Where
from tests.study.tiny import TOML


def read(tmp_path, text: str) -> StudyConfig:
    file = tmp_path / "mine.toml"
    file.write_text(text)
    return read_study(file)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_studies_can_be_read_and_stored(tmp_path, name):
    study = read_study(name)
    assert study.name == name
    assert study.about
    assert from_dict(StudyConfig, json.loads(json.dumps(to_dict(study)))) == study
    write_study(study, tmp_path)
    assert read_study(tmp_path) == study


def test_the_paper_is_twelve_cells():
    study = read_study("paper")
    cells = {(run.env.robot, run.env.colours, run.agent) for run in study.runs()}
    assert len(cells) == len(study.cells()) == 12
    assert {run.role for run in study.runs()} == {"baseline", "knowledge"}
    assert study.evaluations[0].episodes == 1000


def test_the_study_of_choosing_holds_controls_of_its_subject_and_every_split():
    study = read_study("choose")
    agents = {run.agent for run in study.runs()}
    assert set(controls_of("subgraph", "content_control")) & agents
    assert {AGENTS[name].role for name in agents} >= {"baseline", "knowledge", "privileged"}
    assert [each.split for each in study.evaluations] == ["S1", "S2", "S3", "S4", "S5"]
    assert {(each.distance_m, each.angle_deg) for each in study.evaluations} == {(0.05, 15.0)}


def test_controls_match_the_agents_of_a_study():
    study = read_study("paper")
    control = controls(study, "controls")
    assert {run.role for run in control.runs()} == {"capacity_control", "content_control"}
    assert control.seeds == study.seeds
    assert {run.env for run in control.runs()} == {run.env for run in study.runs()}
    assert len(control.runs()) < len(AGENTS) * 4 * len(study.seeds)
    assert read_study("controls") == read_study("controls", of="paper")


def test_controls_of_a_study_of_choosing_have_its_task(tmp_path):
    control = read_study("controls", of="choose")
    assert control.name == "choose-controls"
    assert "irb120-choose-query-random-fast" in control.cells()
    assert {ExperimentName.parse(cell).task for cell in control.cells()} == {"choose"}
    assert {run.env for run in control.runs()} <= {run.env for run in read_study("choose").runs()}


def test_a_grid_has_a_task(tmp_path):
    grid = ExperimentGrid(
        robots=("irb120",), agents=("bm", "subgraph"), algorithms=("fast",), task="choose"
    )
    assert grid.experiments() == ["irb120-choose-bm-fast", "irb120-choose-subgraph-fast"]
    with pytest.raises(UserError, match=r"task 'chose'.*Did you mean 'choose'"):
        dataclasses.replace(grid, task="chose").experiments()


def test_overrides_of_some_experiments_come_last(tmp_path):
    study = read(
        tmp_path,
        TOML.replace('"irb120-bm-ppo"', '"irb120-bm-ppo", "tiago-bm-ppo"')
        + '[[overrides_for]]\nexperiments = "tiago-*"\nfields.total_steps = 100\n'
        + "fields.stop_when = {success = 0.9}\n",
    )
    steps = {run.env.robot: run.total_steps for run in study.runs()}
    assert steps == {"irb120": 40, "tiago": 100}
    assert study.run("tiago-bm-ppo", 1).stop_when.success == 0.9
    assert study.run("tiago-bm-ppo", 1).algorithm.num_envs == 4
    assert study.where == Where()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("bm-ppo", "bn-ppo"), ["line 3", "'bn'", "'bm'"]),
        (("seeds = [0, 1]", "seeds = [0, 0]"), ["line 4", "'0' is given twice"]),
        (("seeds = [0, 1]", "seeds = 3"), ["line 4", "seeds must be a list"]),
        (("seeds = [0, 1]", "sedes = [0]"), ["line 4", "'sedes'", "'seeds'"]),
        (("seeds = [0, 1]", "seeds = []"), ["line 4", "got none"]),
        (("total_steps", "total_step"), ["line 6", "'total_step'", "'total_steps'"]),
        (("num_envs = 4", "num_envs = 3"), ["line 9", "minibatches"]),
        (('["irb120-bm-ppo"]', '["irb120-bm-ppo", "irb120-bm-ppo"]'), ["line 3", "twice"]),
        (("episodes = 2\nprobes", "episodes = 0\nprobes"), ["episodes must be at least 1"]),
        (('name = "tiny"', 'name = "../x"'), ["line 2", "name must be a name of letters"]),
        (("[overrides]", '[where]\nkind = "slurm"\n[overrides]'), ["line 6", "'slurm'", "local"]),
        (
            ("[[eval", '[[overrides_for]]\nexperiments = "*"\nfields.name = "x"\n[[eval'),
            ["overrides must not set 'name'"],
        ),
        (("[overrides]", "[overrides"), ["not TOML", "line 5"]),
    ],
)
def test_a_mistake_in_the_file_is_named_with_its_line(tmp_path, change, words):
    with pytest.raises(UserError) as error:
        read(tmp_path, TOML.replace(*change, 1))
    for word in ["mine.toml", *words]:
        assert word in str(error.value)


def test_unknown_studies_are_named(tmp_path):
    with pytest.raises(UserError, match=r"'papper'.*'paper'"):
        read_study("papper")
    with pytest.raises(UserError, match="Cannot read"):
        read_study(tmp_path / "none.toml")
    with pytest.raises(UserError, match="no study of controls"):
        read_study("smoke", of="paper")
