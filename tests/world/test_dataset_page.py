"""`knowarm view DATASET`: recorded datasets as pages, and folders that are damaged."""

import shutil

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from knowarm.cli.main import main
from knowarm.reading import read_json, write_json
from knowarm.world.viewing.dataset import COLOURS


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("my data") / "played"
    words = ["record", "oracle", "--env.task", "choose", "--episodes", "3"]
    assert main([*words, "--to", str(folder)]) == 0
    return folder


def view(folder, page, *options):
    return main(["view", str(folder), "--page", str(page), "--no-browser", *options])


def test_a_page_shows_episodes_joints_and_questions(dataset, tmp_path, capsys):
    page = tmp_path / "page.html"
    assert view(dataset, page, "--episodes", "2") == 0
    assert "2 episodes of" in capsys.readouterr().out
    text = page.read_text()
    assert "3 episodes, " in text
    assert text.count("data:image/webp") == 2
    first, second, _ = pq.read_table(dataset / "meta/episodes")["tasks"].to_pylist()
    for task in (*first, *second):
        assert f"<td>{task}</td>" in text
    info = read_json(dataset / "meta/info.json")
    for joint, colour in zip(
        info["features"]["observation.state"]["names"], COLOURS, strict=False
    ):
        mark = f'<i class="swatch c-{colour}" aria-hidden="true"></i>'
        assert f"<td>{mark}{joint}</td>" in text
        assert text.count(f'<g class="c-{colour}">') == 2
    assert "Episode 1: " in text
    assert "Episode 2: " not in text


TASKS = {
    "no tasks": lambda file: pq.write_table(pa.table({"task": ["reach"]}), file),
    "other tasks": lambda file: pq.write_table(
        pa.table({"task_index": [99], "task": ["reach"]}), file
    ),
    "a folder": lambda file: file.mkdir(),
}


def test_what_is_no_dataset_of_images_is_one_line(dataset, tmp_path, capsys):
    page = tmp_path / "page.html"
    for change, words in (
        ("no data", "holds no episodes"),
        ("videos", "has no images in its Parquet files"),
        ("cut", "is damaged"),
        ("no names", "info.json is damaged"),
        ("no tasks", "missing 'task_index'"),
        ("other tasks", "is damaged"),
        ("a folder", "is damaged"),
        ("a joint more", "is damaged"),
    ):
        folder = shutil.copytree(dataset, tmp_path / change)
        info = read_json(folder / "meta/info.json")
        features = info["features"]
        if change == "no data":
            shutil.rmtree(folder / "data")
        elif change == "videos":
            features["observation.image"]["dtype"] = "video"
        elif change == "no names":
            features["observation.state"]["names"] = None
        elif change == "a joint more":
            features["observation.state"]["names"].append("seventh")
        elif change in TASKS:
            (folder / "meta/tasks.parquet").unlink()
            TASKS[change](folder / "meta/tasks.parquet")
        else:
            file = folder / "data/chunk-000/file-000.parquet"
            file.write_bytes(file.read_bytes()[:-100])
        write_json(folder / "meta/info.json", info)
        assert view(folder, page) == 2, change
        error = capsys.readouterr().err
        assert words in error
        assert error.count("\n") == 1
    assert view(dataset, page, "--strip", "strip.png") == 2
    assert "give --page, --episodes and --browser alone" in capsys.readouterr().err
    assert not page.exists()
