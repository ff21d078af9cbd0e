"""The example that converts graphs of others: names of objects, all splits, mistakes."""

import subprocess
import sys
from pathlib import Path

from knowarm.asking.answers import answer
from knowarm.knowledge import read_graph

SCRIPT = Path(__file__).parents[1] / "examples" / "other_graphs" / "convert.py"
FACETS = [("mug", "red"), ("watering_can", "blue"), ("vase", "red")]


def convert(source, out):
    command = [sys.executable, str(SCRIPT), str(source), str(out)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_robocse(tmp_path):
    folder, out = tmp_path / "THOR_U", tmp_path / "thor.tsv"
    folder.mkdir()
    names = [
        "mug.o",
        "mug.l",
        "wateringcan.o",
        "vase.o",
        "empty.a",
        "empty.s",
        "kitchen.r",
    ]
    entities = [f"{name}\t{number}" for number, name in enumerate(names)]
    texts = {
        "entity2id": "\n".join([str(len(names)), *entities]),
        "relation2id": "3\nObjCanBe\t0\nObjInRoom\t1\nObjhasState\t2\n",
        "train2id": "3\n0,4,0\n2,4,0\n0,5,2\n",  # heads, tails, relations; commas in this one
        "valid2id": "1\n0\t6\t1\n",
        "test2id": "1\n3 6 1\n",
    }
    for name, text in texts.items():
        (folder / f"{name}.txt").write_text(text)
    done = convert(folder, out)
    assert done.returncode == 0, done.stderr
    assert "not the version" in done.stdout
    graph = read_graph(out)
    assert set(graph) == {
        ("mug", "ObjCanBe", "empty (a)"),
        ("watering_can", "ObjCanBe", "empty (a)"),
        ("mug", "ObjhasState", "empty (s)"),
        ("mug", "ObjInRoom", "kitchen"),
        ("vase", "ObjInRoom", "kitchen"),
    }
    found = answer(graph, FACETS, 'ObjCanBe "empty (a)" and not ObjInRoom kitchen')
    assert set(found.evidence) == {("watering_can", "blue")}


def test_behavior(tmp_path):
    source, out = tmp_path / "synsets.csv", tmp_path / "behavior.tsv"
    source.write_text(
        "synset,hypernyms,prune,is_custom,breakable,fillable,objectType,sceneObject\n"
        "mug.n.04,drinking_vessel.n.01,0,1,1,1,rigidBody,0\n"
        'vase.n.01,"jar.n.01,ornament.n.01",0,0,1,0,rigidBody,1\n'
        "drinking_vessel.n.01,vessel.n.03,0,0,0,0,,0\n"
        "sofa.n.01,seat.n.03,0,0,0,0,rigidBody,0\n"
    )
    assert convert(source, out).returncode == 0
    assert set(read_graph(out)) == {
        ("mug", "hasProperty", "breakable"),
        ("mug", "hasProperty", "fillable"),
        ("mug", "isA", "drinking_vessel"),
        ("drinking_vessel", "isA", "vessel"),
        ("vase", "hasProperty", "breakable"),
        ("vase", "isA", "jar"),
        ("vase", "isA", "ornament"),
    }


def test_what_cannot_be_read_is_one_line(tmp_path):
    for name in ("other.csv", "synsets.csv"):
        done = convert(tmp_path / name, tmp_path / "out.tsv")
        assert done.returncode == 1
        assert done.stderr.count("\n") == 1
        assert "Traceback" not in done.stderr
