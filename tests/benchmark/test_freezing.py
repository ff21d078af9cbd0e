"""A suite of one's own: frozen in a folder, played, verified, tabled, and refused if it changed."""

import shlex
import shutil

import numpy as np
import pytest

from knowarm.benchmark import freezing
from knowarm.benchmark.rows import read_row
from knowarm.benchmark.suites import find_cells, read_suite
from knowarm.cli.main import main
from knowarm.errors import UserError
from knowarm.knowledge.formats import read_graph, write_graph
from knowarm.reading import read_json, write_json
from scripts import freeze_suites
from tests.source_tree import ROOT

ROBOT = ROOT / "src" / "knowarm" / "world" / "robots" / "irb120"
SMALL = "--episodes 4 --control-episodes 2 --training-seeds 1"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a robot, an object and a graph, in which the fixed list is not searched."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROBOT, tmp_path / "my arm")
    (tmp_path / "my arm" / "irb120.toml").rename(tmp_path / "my arm" / "mira.toml")
    monkeypatch.setattr(
        freezing, "search_open_loop", lambda env: np.zeros((50, 6), np.int64)
    )
    return tmp_path


def run(command):
    return main(shlex.split(command))


def test_a_suite_of_one_s_own_is_frozen_played_verified_and_tabled(folder, capsys):
    freeze = f"benchmark freeze reach 'my arm/mira.toml' --to 'my suite' {SMALL}"
    assert run(f"{freeze} --targets mug kettle") == 0
    printed = capsys.readouterr().out.splitlines()[-1]
    assert printed == "knowarm benchmark run 'my suite' --policy oracle"
    suite = read_suite("my suite")
    (cell,) = suite.cells.values()
    assert cell.name == "mira"
    assert cell.env.targets == ("mug", "kettle")
    assert cell.env.success_distance_m == 0.05
    assert len(cell.episodes) == 4
    assert cell.reference["oracle"] == 1
    assert run("benchmark run 'my suite' --policy oracle --out rows/oracle.json") == 0
    assert run("benchmark verify rows/oracle.json") == 0
    assert "with the same outcomes on MuJoCo" in capsys.readouterr().out
    row = read_row(folder / "rows" / "oracle.json")
    assert row["suite"] == "my suite"
    assert row["mujoco"]
    assert run("benchmark table rows --out table.html") == 0
    assert "mira, fixed colours" in (folder / "table.html").read_text()
    for name in ("my suite", "my suite/mi"):
        assert [cell.name for cell in find_cells(name)[1]] == ["mira"]
    assert run(f"{freeze} --targets mug") == 2
    assert "never written again" in capsys.readouterr().err


def test_it_keeps_copies_and_notices_a_change(folder, capsys):
    write_graph(read_graph("objects"), folder / "mine.ttl")
    asked = "--graph mine.ttl --splits S1 S5"
    assert run(f"benchmark freeze choose irb120 --to asked {asked} {SMALL}") == 0
    before = read_suite("asked").cells
    assert list(before) == ["irb120-S1", "irb120-S5"]
    assert before["irb120-S1"].reference["chance"] == 0.25
    (folder / "mine.ttl").unlink()
    after = read_suite("asked").cells["irb120-S1"]
    assert list(after.episodes.question) == list(before["irb120-S1"].episodes.question)
    assert after.env.task.asked.queries.graph.startswith("asked/inputs/")
    assert run(f"benchmark freeze reach 'my arm/mira.toml' --to kept {SMALL}") == 0
    digest = read_suite("kept").digest
    shutil.rmtree(folder / "my arm")
    assert read_suite("kept").digest == digest
    shutil.move(folder / "kept", folder / "moved")
    with pytest.raises(UserError, match=r"trusted like code|missing or was changed"):
        read_suite("moved")
    shutil.move(folder / "moved", folder / "kept")
    (copy,) = (folder / "kept" / "inputs").rglob("mira.toml")
    copy.write_text(copy.read_text() + "# changed\n")
    with pytest.raises(UserError, match=r"changed since") as error:
        read_suite("kept")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["nowhere", "my arm", "", "../rows"])
def test_what_is_no_suite_is_refused_in_one_line(folder, name):
    with pytest.raises(UserError, match=r"Unknown suite.*choose-v1.*benchmark freeze"):
        read_suite(name)


def test_a_damaged_folder_and_a_row_of_another_suite_are_refused(folder, capsys):
    assert run(f"benchmark freeze reach irb120 --to suite --targets mug {SMALL}") == 0
    assert run("benchmark run suite --policy zero --out row.json") == 0
    row = read_json(folder / "row.json")
    write_json(folder / "other.json", {**row, "suite": "reach-v1"})
    with pytest.raises(UserError, match="measured on another reach-v1"):
        read_row(folder / "other.json")
    (folder / "suite" / "suite.json").write_text("{")
    with pytest.raises(UserError, match="freeze the suite again"):
        read_suite("suite")
    capsys.readouterr()
    assert run("benchmark freeze reach irb12 --to other") == 2
    assert "irb120" in capsys.readouterr().err
    assert not (folder / "other").exists()


def test_a_refusal_names_the_cells_that_fit(folder, capsys):
    policy = ROOT / "zoo" / "irb120-full-fast"
    command = f"benchmark run reach-v1 --policy '{policy}' --trial 2"
    assert run(command) == 2
    error = capsys.readouterr().err
    assert "irb120-randomized of reach-v1 cannot be played" in error
    assert "Cells that fit: irb120-fixed. Play one with --cells irb120-fixed." in error
    assert run(f"{command} --cells irb120-fixed") == 0
    capsys.readouterr()
    assert run(f"benchmark run choose-v1 --policy '{policy}' --trial 2") == 2
    assert "No cell of this suite fits" in capsys.readouterr().err


def test_a_published_suite_is_drawn_again_and_compared(monkeypatch):
    assert freeze_suites.store("damaged-graph-v1").endswith(", as it is published")
    choose = read_suite("choose-v1")
    monkeypatch.setitem(freeze_suites.SUITES, "reach-v1", lambda: choose)
    files = [*freeze_suites.FOLDER.glob("reach-v1.*")]
    before = [file.read_bytes() for file in files]
    with pytest.raises(SystemExit, match=choose.digest[:16]) as error:
        freeze_suites.store("reach-v1")
    assert read_suite("reach-v1").digest[:16] in str(error.value)
    assert "\n" not in str(error.value)
    assert [file.read_bytes() for file in files] == before


def test_a_new_suite_is_stored(tmp_path, monkeypatch):
    choose = read_suite("choose-v1")
    monkeypatch.setattr(freeze_suites, "FOLDER", tmp_path)
    monkeypatch.setitem(freeze_suites.SUITES, "choose-v2", lambda: choose)
    assert freeze_suites.store("choose-v2").endswith(f"{choose.digest}, new")
    files = [tmp_path / f"choose-v2{suffix}" for suffix in (".json", ".safetensors")]
    assert tuple(file.read_bytes() for file in files) == choose.data
