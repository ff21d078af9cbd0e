"""What finds or reads robots, runs, policies and studies grants no trust in their files."""

import ast
import json
import shutil
from contextlib import suppress

import pytest

from knowarm.benchmark.policies import entrant
from knowarm.cli.main import main
from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.experiment.load import load_agent
from knowarm.experiment.names import experiment_config
from knowarm.experiment.run_folder import RunFolder
from knowarm.experiment.run_inputs import input_content
from knowarm.experiment.zoo import open_run
from knowarm.report.collect import collect
from knowarm.study.config import StudyConfig, read_study
from knowarm.study.status import study_status
from knowarm.world.robots import find_robot
from tests.source_tree import ROOT

FINDERS = {
    "robot": lambda run, study: find_robot(*map(str, run.glob("**/scara.toml"))),
    "run": lambda run, study: RunFolder.open(run).experiment(),
    "shipped or own run": lambda run, study: open_run(run),
    "digest": lambda run, study: input_content(open_run(run).experiment().env.robot),
    "agent": lambda run, study: load_agent(run),
    "entrant": lambda run, study: entrant(str(run)),
    "report": lambda run, study: collect([run]),
    "study": lambda run, study: read_study(study),
    "status": lambda run, study: study_status(read_study(study), run.parents[1]),
    "`evaluate`": lambda run, study: main(["evaluate", str(run)]),
    "`view`": lambda run, study: main(["view", str(run)]),
    "`list`": lambda run, study: main(["list", "robots"]),
    "`study status`": lambda run, study: main(["study", "status", str(study)]),
    "`benchmark`": lambda run, study: main(["benchmark", "run", str(run)]),
}
"""What finds or reads robots, runs, policies and studies, through every kind of door."""


@pytest.mark.parametrize("finder", FINDERS)
def test_finders_grant_no_trust(tmp_path, monkeypatch, finder):
    monkeypatch.setenv("KNOWARM_CACHE", str(tmp_path / "cache"))
    own = shutil.copytree(ROOT / "examples" / "own_robot", tmp_path / "own")
    robot = str(own / "scara.toml")
    config = experiment_config("full-fast", env={"robot": robot})
    before = RunFolder.create(tmp_path / "run")
    before.write_experiment(config)
    study = tmp_path / "moved"
    run = study / config.name / "0"
    run.parent.mkdir(parents=True)
    shutil.move(before.path, run)  # its copy of the robot lies at a path without trust
    overrides = {"env": {"robot": robot}}
    values = StudyConfig(
        name="s", experiments=("full-fast",), seeds=(0,), overrides=overrides
    )
    text = json.dumps({"format": 1, **to_dict(values)})
    (study / "study.json").write_text(text)
    marks = {file: file.read_bytes() for file in tmp_path.glob("cache/trusted/*")}
    assert len(marks) == 2
    with suppress(UserError):  # of the run's missing parts
        FINDERS[finder](run, study)
    after = {file: file.read_bytes() for file in tmp_path.glob("cache/trusted/*")}
    assert after == marks


GRANTING = {
    "trust": {
        "cli/main.py",  # descriptions that the user's command names
        "experiment/run_folder.py",
        "experiment/run_inputs.py",
        "study/config.py",
    },
    "write_experiment": {"experiment/run.py", "experiment/sb3_run.py"},  # trainings
    "copy_input": {"experiment/run_folder.py", "benchmark/freezing.py"},
    "write_study": {"study/driver.py"},
}
"""Functions that grant trust in descriptions, and the files that call them."""


@pytest.mark.parametrize("function", GRANTING)
def test_trust_is_granted_where_a_command_trains_freezes_or_names_a_robot(function):
    source = ROOT / "src" / "knowarm"
    callers = set()
    for file in source.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.Call) and function == getattr(
                node.func, "id", getattr(node.func, "attr", None)
            ):
                callers.add(file.relative_to(source).as_posix())
    assert callers == GRANTING[function]
