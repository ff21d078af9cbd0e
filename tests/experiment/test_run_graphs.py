"""A run keeps the graphs of the user that it was trained with."""

from dataclasses import replace
from pathlib import Path

import pytest

from knowarm.experiment.names import experiment_config
from knowarm.experiment.run import other_fields
from knowarm.experiment.run_folder import RunFolder

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
    assert Path(read).is_relative_to(folder.graphs)
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


def test_a_folder_with_the_name_of_a_shipped_graph_is_no_graph_of_the_run(tmp_path, monkeypatch):
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
        "irb120-choose-subgraph-fast", env={"task": {"queries": {"edited": str(edited)}}}
    )
    folder = RunFolder.create(tmp_path / "run")
    folder.write_experiment(config)
    edited.unlink()
    assert Path(folder.experiment().env.task.queries.edited).read_text() == GRAPH


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
    (copy,) = folder.graphs.glob("*/kitchen.csv")
    copy.rename(copy.with_name(".kitchen.csv.tmp")).write_text("head,rel")
    folder.write_experiment(config)
    assert [each.read_text() for each in folder.graphs.glob("*/*")] == [GRAPH]
