"""The shipped policies are small, whole, and have the knowledge that the package builds.

What they reach: tests/test_front_door_outcomes.py.
"""

import dataclasses
import shutil
from pathlib import Path

import pytest

from knowarm.errors import UserError
from knowarm.experiment.load import load_agent
from knowarm.reading import read_json, write_json

ZOO = Path(__file__).parents[2] / "zoo"
AGENTS = sorted(path.name for path in ZOO.iterdir() if path.is_dir())


@pytest.mark.parametrize("name", AGENTS)
def test_a_shipped_policy_is_small(name):
    assert (
        sum(file.stat().st_size for file in (ZOO / name).rglob("*") if file.is_file())
        < 8e6
    )


@pytest.mark.parametrize("name", AGENTS)
def test_the_knowledge_it_was_trained_with_is_what_the_package_builds(name):
    from knowarm.experiment.build import build

    trained = load_agent(ZOO / name)
    assert trained.config.name == name
    parts = build(dataclasses.replace(trained.config))
    assert parts.knowledge.table.tobytes() == trained.folder.knowledge().tobytes()


def test_a_checkpoint_of_another_policy_is_refused(tmp_path):
    path = Path(shutil.copytree(ZOO / "irb120-full-fast", tmp_path / "run"))
    provenance = read_json(path / "provenance.json")
    provenance["policy"]["shape"]["joints"] += 1
    write_json(path / "provenance.json", provenance)
    with pytest.raises(
        UserError, match=r"does not fit the policy.*size mismatch.*restore it"
    ):
        load_agent(path)
