"""What finds or reads robots, runs, policies and studies grants no trust in their files."""

import ast
import json
import shutil

import pytest

from knowarm.cli.main import main
from knowarm.config import to_dict
from knowarm.experiment.names import experiment_config
from knowarm.experiment.run_folder import RunFolder
from knowarm.study.config import StudyConfig
from tests.source_tree import ROOT, modules

pytestmark = pytest.mark.usefixtures("unfenced")

COMMANDS = {
    "evaluate": lambda run, study: ["evaluate", run],
    "view": lambda run, study: ["view", run],
    "list": lambda run, study: ["list", "robots"],
    "study status": lambda run, study: ["study", "status", study],
    "benchmark": lambda run, study: ["benchmark", "run", run],
    "report": lambda run, study: ["report", run],
}
"""Commands that read robots, runs, policies and studies, which name a description."""


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_grant_no_trust_in_what_a_run_names(tmp_path, monkeypatch, command):
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
    main(
        [*map(str, COMMANDS[command](run, study))]
    )  # some end for the run's missing parts
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
    callers = set()
    for path, tree in modules().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and function == getattr(
                node.func, "id", getattr(node.func, "attr", None)
            ):
                callers.add(path)
    assert callers == GRANTING[function]
