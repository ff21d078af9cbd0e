"""The shipped policies are small, whole, and have the knowledge that the package builds.

What they reach: tests/test_front_door_outcomes.py.
"""

import dataclasses
import shutil
import tomllib
from pathlib import Path

import pytest

from knowarm.cli.main import main
from knowarm.errors import UserError
from knowarm.experiment import zoo
from knowarm.experiment.load import load_agent
from knowarm.experiment.run_folder import RunFolder
from knowarm.reading import read_json, write_json

ROOT = Path(__file__).parents[2]
ZOO = ROOT / "zoo"
HUB = "irb120-full-fast"
AGENTS = sorted(path.name for path in ZOO.iterdir() if path.is_dir())


@pytest.mark.parametrize("name", AGENTS)
def test_a_shipped_policy_is_small(name):
    assert (
        sum(file.stat().st_size for file in (ZOO / name).rglob("*") if file.is_file())
        < 8e6
    )


@pytest.mark.parametrize("name", AGENTS)
def test_the_knowledge_it_was_trained_with_is_what_the_package_builds(name):
    from knowarm.experiment.run import build

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


def test_every_shipped_policy_is_known_by_its_files():
    digests = {name: RunFolder.open(ZOO / name).digest[:32] for name in AGENTS}
    assert digests == zoo.POLICIES


def test_the_wheel_and_the_source_hold_one_policy():
    with (ROOT / "pyproject.toml").open("rb") as file:
        targets = tomllib.load(file)["tool"]["hatch"]["build"]["targets"]
    files = set()
    for source, target in targets["wheel"]["force-include"].items():
        assert target == f"knowarm/{source}"
        path = ROOT / source
        files |= {path} if path.is_file() else set(path.iterdir())
    folder = ROOT / zoo.PACKAGED
    assert files == {
        path
        for path in folder.rglob("*")
        if path.is_file() and "evaluation" not in path.parts
    }
    assert sum(path.stat().st_size for path in files) < 4e6
    assert f"/{zoo.PACKAGED}" in targets["sdist"]["include"]


def test_a_shipped_policy_is_found_here_then_in_a_clone_then_in_the_package(
    tmp_path, monkeypatch, caplog
):
    monkeypatch.chdir(tmp_path)
    path = "zoo/irb120-full-fast"
    package = shutil.copytree(ZOO / "irb120-full-fast", tmp_path / "site" / path)
    folders = {"a clone": ZOO, "the package": package.parent}
    monkeypatch.setattr(zoo, "FOLDERS", folders)
    assert load_agent(path).folder.path == ZOO / "irb120-full-fast"
    assert f"is that of a clone: {ZOO}" in caplog.text
    monkeypatch.setattr(zoo, "FOLDERS", {"the package": package.parent})
    assert load_agent(f"./{path}/").folder.path == package
    assert f"is that of the package: {package}" in caplog.text
    shutil.copytree(ZOO / "tiago-full-fast", path)  # one of one's own, of this name
    caplog.clear()
    assert load_agent(path).folder.path == Path(path)
    assert not caplog.text


def test_an_evaluation_writes_nothing_into_the_package(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    path = "zoo/irb120-full-fast"
    package = shutil.copytree(ZOO / "irb120-full-fast", tmp_path / "site" / path)
    shutil.rmtree(package / "evaluation", ignore_errors=True)
    monkeypatch.setattr(zoo, "FOLDERS", {"the package": package.parent})
    main(["evaluate", path, "--episodes", "2", "--blind-episodes", "0"])
    assert "Nothing is saved in the package" in capsys.readouterr().err
    assert not (package / "evaluation").exists()


def test_what_is_nowhere_here_comes_from_the_hub_if_it_is_the_shipped_one(
    tmp_path, monkeypatch, caplog
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(zoo, "FOLDERS", {})
    pulled = []

    def pull(repository):
        pulled.append(repository)
        return ZOO / HUB

    monkeypatch.setattr(zoo, "pull_from_hub", pull)
    assert load_agent("zoo/irb120-full-fast").step > 0
    assert pulled == ["knowarm/irb120-full-fast"]
    assert "is that of the Hub, knowarm/irb120-full-fast" in caplog.text
    with pytest.raises(UserError, match="is not the policy that KnowArm ships"):
        load_agent("zoo/tiago-full-fast")

    def refuse(repository):
        raise UserError("The Hub did not serve it: no connection.")

    monkeypatch.setattr(zoo, "pull_from_hub", refuse)
    with pytest.raises(
        UserError, match=r"neither .* no connection\. The package holds"
    ):
        load_agent("zoo/irb120-full-fast")
    with pytest.raises(UserError, match=r"Did you mean 'irb120-full-fast'"):
        load_agent("zoo/irb120-full")
