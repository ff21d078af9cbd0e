"""A run keeps the graphs, robots and objects of the user that it was trained with."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.experiment.names import experiment_config
from knowarm.experiment.run import other_fields
from knowarm.experiment.run_folder import RunFolder
from knowarm.experiment.run_inputs import input_content
from knowarm.world.scene.scene import load_scene

ROOT = Path(__file__).parents[2]
PAD = """v 0 0 0
v .1 0 0
v 0 .1 0
v 0 0 .1
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""
GRAPH = "head,relation,tail\nmug,usedFor,drinking\n"


@pytest.fixture
def run(tmp_path):
    """A run folder of a config with a user's graph."""
    path = tmp_path / "kitchen.csv"
    path.write_text(GRAPH)
    config = experiment_config("irb120-full-fast")
    config = replace(config, knows=replace(config.knows, graph=str(path)))
    folder = RunFolder.create(tmp_path / "run")
    folder.write_experiment(config)
    return folder, path, config


@pytest.mark.parametrize("change", ["none", "gone", "edited"])
def test_the_copy_is_read_whatever_became_of_the_original(run, change):
    folder, path, config = run
    if change == "gone":
        path.unlink()
    elif change == "edited":
        path.write_text("head,relation,tail\nmug,is,red\n")
    read = folder.experiment().knows.graph
    assert Path(read).is_relative_to(folder.path / "graphs")
    assert Path(read).read_text() == GRAPH
    assert bool(other_fields(folder, config)) == (change == "edited")


@pytest.mark.parametrize("file", ["entity2id.txt", "more/facts.csv"])
def test_a_graph_of_several_files_is_kept_and_compared(run, tmp_path, file):
    folder, _, config = run
    part = tmp_path / "openke" / file
    part.parent.mkdir(parents=True)
    part.write_text(GRAPH)
    graph = str(tmp_path / "openke")
    config = replace(config, knows=replace(config.knows, graph=graph))
    folder.write_experiment(config)
    assert not other_fields(folder, config)
    part.write_text("changed")
    assert other_fields(folder, config)


def test_a_folder_with_the_name_of_a_shipped_graph_is_no_graph_of_the_run(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "objects").mkdir()
    (tmp_path / "objects" / "mug.txt").write_text("mine")
    config = experiment_config("irb120-choose-subgraph-fast")
    folder = RunFolder.create(tmp_path / "run")
    folder.write_experiment(config)
    assert not (tmp_path / "run" / "graphs").exists()
    assert folder.experiment() == config


def test_the_edited_graph_of_s5_is_kept(tmp_path):
    edited = tmp_path / "edited.csv"
    edited.write_text(GRAPH)
    config = experiment_config(
        "irb120-choose-subgraph-fast",
        env={"task": {"asked": {"queries": {"edited": str(edited)}}}},
    )
    folder = RunFolder.create(tmp_path / "run")
    folder.write_experiment(config)
    edited.unlink()
    assert Path(folder.experiment().env.task.asked.queries.edited).read_text() == GRAPH


def test_a_resumed_run_keeps_the_name_of_the_original(run):
    folder, path, config = run
    before = folder.config_path.read_text()
    path.write_text("head,relation,tail\nmug,is,red\n")
    assert "restore" in other_fields(folder, config)["knows.graph"]
    folder.write_experiment(folder.experiment())
    assert folder.config_path.read_text() == before
    path.write_text(GRAPH)
    assert not other_fields(folder, config)


def test_a_graph_that_was_copied_in_part_is_copied_again(run):
    folder, _, config = run
    (copy,) = (folder.path / "graphs").glob("*/kitchen.csv")
    copy.rename(copy.with_name(".kitchen.csv.tmp")).write_text("head,rel")
    folder.write_experiment(config)
    assert [each.read_text() for each in (folder.path / "graphs").glob("*/*")] == [
        GRAPH
    ]


@pytest.fixture
def arm(tmp_path):
    """A folder with an own arm, whose MJCF file includes another and has a mesh, and a run of it.

    Both lie in folders beside the one of the description.
    """
    own = shutil.copytree(ROOT / "examples" / "own_robot", tmp_path / "own")
    models = tmp_path / "models"
    (models / "meshes").mkdir(parents=True)
    (models / "meshes" / "pad.obj").write_text(PAD)
    parts = '<mujoco><asset><mesh name="pad" file="pad.obj"/></asset></mujoco>'
    (models / "parts.xml").write_text(parts)
    text = (own / "scara.xml").read_text()
    head = '<compiler meshdir="meshes"/><include file="parts.xml"/><worldbody>'
    assert "meshdir" not in text
    text = text.replace("<worldbody>", f'{head}<geom type="mesh" mesh="pad"/>', 1)
    (models / "scara.xml").write_text(text)
    (own / "scara.xml").unlink()
    toml = own / "scara.toml"
    toml.write_text(
        toml.read_text().replace('mjcf = "scara.xml"', 'mjcf = "../models/scara.xml"')
    )
    config = experiment_config("full-fast", env={"robot": str(toml)})
    folder = RunFolder.create(tmp_path / "run")
    folder.write_experiment(config)
    return tmp_path, folder, config


def test_a_run_plays_its_own_copy_of_a_robot_whatever_became_of_the_original(arm):
    path, folder, config = arm
    before = load_scene(config.env.robot, config.env.targets).model
    assert before.nmesh
    assert not other_fields(folder, config)
    for name in ("own", "models"):
        shutil.rmtree(path / name)
    env = folder.experiment().env
    assert Path(env.robot).is_relative_to(folder.path)
    after = load_scene(env.robot, env.targets).model
    assert np.array_equal(after.mesh_vert, before.mesh_vert)
    assert np.array_equal(after.body_pos, before.body_pos)


@pytest.mark.parametrize(
    "changed",
    ["own/scara.toml", "models/scara.xml", "models/parts.xml", "models/meshes/pad.obj"],
)
def test_a_changed_robot_is_neither_played_nor_trained_on(arm, changed):
    path, folder, config = arm
    content = input_content(folder.experiment().env.robot)
    assert content == input_content(config.env.robot)
    file = path / changed
    file.write_text(file.read_text() + "\n")
    different = other_fields(folder, config)
    assert [*different] == ["env.robot"]
    assert "restore the original from it, which has changed" in different["env.robot"]
    assert input_content(folder.experiment().env.robot) == content
    folder.write_experiment(folder.experiment())  # as resuming does
    assert (
        json.loads(folder.config_path.read_text())["env"]["robot"] == config.env.robot
    )


def test_the_robot_of_a_moved_run_is_trusted_while_it_equals_the_original(arm):
    path, folder, _ = arm
    moved = RunFolder(shutil.move(folder.path, path / "moved"))
    assert Path(moved.experiment().env.robot).is_relative_to(moved.path)
    toml = path / "own" / "scara.toml"
    toml.write_text(toml.read_text() + "\n")
    with pytest.raises(UserError, match=rf"doctor --robot {moved.path}/descriptions"):
        moved.experiment()


def test_a_mesh_that_the_copy_would_not_hold_is_refused(arm):
    path, _, config = arm
    xml = path / "models" / "parts.xml"
    xml.write_text(
        xml.read_text().replace("pad.obj", str(path / "models" / "meshes" / "pad.obj"))
    )
    with pytest.raises(UserError, match="by an absolute path"):
        RunFolder.create(path / "other").write_experiment(config)
