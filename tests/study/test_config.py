import dataclasses
import json

import pytest

from knowarm.config import differences, from_dict, to_dict
from knowarm.errors import UserError
from knowarm.experiment.agents import AGENTS, controls_of
from knowarm.experiment.names import ExperimentName, experiment_config
from knowarm.experiment.run import build
from knowarm.knowledge.queries.splits import SEEDS
from knowarm.study.config import (
    SHIPPED,
    ExperimentGrid,
    StudyConfig,
    controls,
    read_study,
    write_study,
)
from knowarm.study.executor import Where
from tests.study.tiny import TOML, tiny


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


def test_the_papers_algorithm_is_run_on_the_papers_cells_in_the_declared_order():
    study = read_study("paper-a3c")
    runs = study.runs()
    names = [f"{run.name}/{run.seed}" for run in runs]
    assert study.order == "listed"
    assert names[:6] == [
        f"{robot}-{agent}-dr-a3c/0"
        for robot in ("irb120", "tiago")
        for agent in ("bm", "full", "zeros")
    ]
    assert [run.seed for run in runs[6:9]] == [1, 1, 1]
    assert [run.name for run in runs[6:9]] == [run.name for run in runs[:3]]
    assert {run.agent for run in runs[-4:]} == {"partial"}
    cells = {(run.env.robot, run.env.colours, run.agent) for run in runs}
    assert cells >= {
        (run.env.robot, run.env.colours, run.agent)
        for run in read_study("paper").runs()
    }
    assert {run.total_steps for run in runs} == {70_000_000}
    thresholds = {
        each.folder: (each.distance_m, each.angle_deg) for each in study.evaluations
    }
    assert thresholds == {
        "post-training-greedy": (0.1, 17),
        "distance": (0.1, 180),
        "strict": (0.05, 15),
        "anova": (0.1, 17),
    }


@pytest.mark.parametrize(
    "name", ["irb120-{}-dr-a3c", "tiago-{}-dr-a3c", "irb120-{}-a3c"]
)
def test_the_control_of_the_papers_algorithm_has_the_size_of_full(name):
    full, zeros = (experiment_config(name.format(agent)) for agent in ("full", "zeros"))
    parts = [build(config) for config in (full, zeros)]
    sizes = [part.new_policy(0).parameter_counts() for part in parts]
    assert sizes[0] == sizes[1]
    assert zeros.algorithm == full.algorithm
    assert parts[0].knowledge.table.any()
    assert not parts[1].knowledge.table.any()


def test_changes_of_the_papers_algorithm_change_nothing_else():
    (published,) = [
        run
        for run in read_study("paper-a3c").runs()
        if (run.name, run.seed) == ("irb120-bm-dr-a3c", 0)
    ]
    changes = {
        name: {*differences(to_dict(published), to_dict(*read_study(name).runs()))}
        for name in ("paper-a3c-decay", "paper-a3c-rewards")
    }
    assert changes == {
        "paper-a3c-decay": {
            "total_steps",
            "algorithm.learning_rate_schedule",
            "algorithm.learning_rate_final",
        },
        "paper-a3c-rewards": {
            "total_steps",
            "algorithm.reward_scale",
            "algorithm.ent_coef",
        },
    }
    decay = read_study("paper-a3c-decay").runs()[0].algorithm
    assert [decay.learning_rate_at(progress) for progress in (0, 0.5, 1)] == [
        1e-4,
        5e-5,
        0,
    ]


def test_a_run_can_be_listed_with_its_seed(tmp_path):
    study = tiny(
        experiments=("irb120-bm-ppo", "irb120-full-ppo/1", "irb120-full-ppo/7")
    )
    keys = [(run.name, run.seed) for run in study.runs()]
    first, second = "irb120-bm-ppo", "irb120-full-ppo"
    assert keys == [(first, 0), (first, 1), (second, 1), (second, 7)]
    assert study.cells() == [first, second]
    assert study.all_seeds() == [0, 1, 7]
    with pytest.raises(UserError, match="'irb120-bm-ppo/1' is given twice"):
        tiny(experiments=(first, f"{first}/1"))


def test_the_study_of_choosing_holds_controls_of_its_subject_and_every_split():
    study = read_study("choose")
    agents = {run.agent for run in study.runs()}
    assert set(controls_of("subgraph", "content_control")) & agents
    assert {AGENTS[name].role for name in agents} >= {
        "baseline",
        "knowledge",
        "privileged",
    }
    assert [each.split for each in study.evaluations] == ["S1", "S2", "S3", "S4", "S5"]
    assert {(each.distance_m, each.angle_deg) for each in study.evaluations} == {
        (0.05, 15.0)
    }


def test_controls_match_the_agents_of_a_study():
    study = read_study("paper")
    control = controls(study)
    assert {run.role for run in control.runs()} == {
        "capacity_control",
        "content_control",
    }
    assert control.seeds == study.seeds
    assert {run.env for run in control.runs()} == {run.env for run in study.runs()}
    assert len(control.runs()) < len(AGENTS) * 4 * len(study.seeds)
    assert read_study("controls") == read_study("controls", of="paper")


def test_controls_of_a_study_of_choosing_have_its_task(tmp_path):
    control = read_study("controls", of="choose")
    assert control.name == "choose-controls"
    assert "irb120-choose-query-random-fast" in control.cells()
    assert {ExperimentName.parse(cell).task for cell in control.cells()} == {"choose"}
    assert {run.env for run in control.runs()} <= {
        run.env for run in read_study("choose").runs()
    }


@pytest.mark.parametrize("studied", ["answers-distil", "families", "choose"])
@pytest.mark.parametrize("draw", ["validation", "test"])
def test_a_draw_repeats_a_study_and_changes_nothing_but_the_draw(studied, draw):
    base = read_study(studied)
    study = read_study(f"{draw}-draw", of=studied)
    seed = SEEDS[draw]
    assert {run.env.task.asked.queries.seed for run in study.runs()} == {seed}
    assert {each.seed for each in study.evaluations} == {seed}
    published = {run.env.task.asked.queries.seed for run in base.runs()}
    assert published == {SEEDS["published"]}
    again = [
        dataclasses.replace(
            run, env=dataclasses.replace(run.env, task=run.env.task.asking(seed=0))
        )
        for run in study.runs()
    ]
    assert again == base.runs()
    first = base.evaluations[0].seed
    assert [dataclasses.replace(each, seed=first) for each in study.evaluations] == [
        *base.evaluations
    ]


def test_a_draw_is_a_declared_one_of_a_study_with_questions(tmp_path):
    assert read_study("test-draw", of="families").name == "families-test-draw"
    text = 'name = "mine"\nredraws = "choose"\ndraw = "lucky"\n'
    with pytest.raises(UserError, match=r"'lucky'.*validation"):
        read(tmp_path, text)
    with pytest.raises(UserError, match="queries"):
        read_study("test-draw", of="smoke")


def test_a_grid_has_a_task(tmp_path):
    grid = ExperimentGrid(
        robots=("irb120",),
        agents=("bm", "subgraph"),
        algorithms=("fast",),
        task="choose",
    )
    assert grid.experiments() == [
        "irb120-choose-bm-fast",
        "irb120-choose-subgraph-fast",
    ]
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
        (
            ('["irb120-bm-ppo"]', '["irb120-bm-ppo", "irb120-bm-ppo"]'),
            ["line 3", "twice"],
        ),
        (
            ("episodes = 2\nprobes", "episodes = 0\nprobes"),
            ["episodes must be at least 1"],
        ),
        (
            ('name = "tiny"', 'name = "../x"'),
            ["line 2", "name must be a name of letters"],
        ),
        (
            ("[overrides]", '[where]\nkind = "slurm"\n[overrides]'),
            ["line 6", "'slurm'", "local"],
        ),
        (
            (
                "[[eval",
                '[[overrides_for]]\nexperiments = "*"\nfields.name = "x"\n[[eval',
            ),
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
