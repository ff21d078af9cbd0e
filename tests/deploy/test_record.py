"""Recorded episodes can be read by plain PyArrow and play again in the simulator."""

import io
import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from PIL import Image

from knowarm.cli.main import main
from knowarm.deploy.record import EPISODES, QUANTILES
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv

COUNT = 5


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recorded") / "dataset"
    assert (
        main(["record", "oracle", "--episodes", str(COUNT), "--to", str(folder)]) == 0
    )
    return folder


@pytest.fixture(scope="module")
def frames(dataset):
    return pq.read_table(dataset / "data/chunk-000/file-000.parquet").to_pylist()


def test_the_actions_lead_through_the_recorded_images_again(dataset, frames):
    env = ArmVectorEnv(EnvConfig(), 1)
    episodes = evaluation_episodes(EnvConfig(), COUNT, 0)
    for number in range(COUNT):
        rows = [frame for frame in frames if frame["episode_index"] == number]
        image, _ = env.reset(options={"episodes": episodes[number : number + 1]})
        for row in rows:
            stored = np.asarray(
                Image.open(io.BytesIO(row["observation.image"]["bytes"]))
            )
            np.testing.assert_array_equal(stored, image[0])
            np.testing.assert_allclose(
                row["observation.state"], env.joint_positions[0], atol=1e-6
            )
            image, _, terminated, _, _ = env.advance(
                [row["action.levels"]], np.array([True])
            )
            np.testing.assert_allclose(row["action"], env.joint_targets[0], atol=1e-6)
            assert row["next.success"] == terminated[0] == row["next.done"]


def test_meta_files_describe_the_data(dataset, frames):
    info = json.loads((dataset / "meta/info.json").read_text())
    rows = pq.read_table(dataset / EPISODES).to_pylist()
    tasks = pq.read_table(dataset / "meta/tasks.parquet").to_pylist()
    assert info["codebase_version"] == "v3.0"
    assert info["total_frames"] == len(frames) == sum(row["length"] for row in rows)
    assert info["total_episodes"] == len(rows) == COUNT
    assert set(info["features"]) == set(frames[0])
    for row in rows:
        part = frames[row["dataset_from_index"] : row["dataset_to_index"]]
        assert {frame["episode_index"] for frame in part} == {row["episode_index"]}
        assert {frame["task_index"] for frame in part} == {
            task["task_index"] for task in tasks if [task["task"]] == row["tasks"]
        }
    stats = json.loads((dataset / "meta/stats.json").read_text())["action"]
    actions = np.array([frame["action"] for frame in frames])
    np.testing.assert_allclose(stats["mean"], actions.mean(0), atol=1e-5)
    np.testing.assert_allclose(stats["std"], actions.std(0), atol=1e-5)
    np.testing.assert_allclose(stats["max"], actions.max(0), atol=1e-5)
    for name, share in QUANTILES.items():
        np.testing.assert_allclose(
            stats[name], np.quantile(actions, share, 0), atol=1e-5
        )


def test_statistics_of_images_are_those_of_their_values(dataset, frames):
    stats = json.loads((dataset / "meta/stats.json").read_text())["observation.image"]
    files = [io.BytesIO(frame["observation.image"]["bytes"]) for frame in frames]
    values = (
        np.stack([np.asarray(Image.open(file)) for file in files]).reshape(-1, 3) / 255
    )
    shares = {
        name: np.quantile(values, q, 0, method="inverted_cdf")
        for name, q in QUANTILES.items()
    }
    others = {name: getattr(values, name)(0) for name in ("min", "max", "mean", "std")}
    for name, expected in (shares | others).items():
        np.testing.assert_allclose(np.squeeze(stats[name]), expected, atol=1e-9)
    assert stats["count"] == [len(frames)]


def test_fingers_follow_a_map_that_does_not_name_them(tmp_path):
    lines = [f'joint_{i} = {{unit = "deg"}}' for i in range(1, 7)]
    (tmp_path / "map.toml").write_text("\n".join(["[joint_map]", *lines]))
    options = [
        "--joint-map",
        str(tmp_path / "map.toml"),
        "--to",
        str(tmp_path / "lifts"),
    ]
    assert (
        main(["record", "oracle", "--env.task", "lift", "--episodes", "1", *options])
        == 0
    )
    action = json.loads((tmp_path / "lifts/meta/info.json").read_text())["features"][
        "action"
    ]
    assert action["units"] == ["deg"] * 6 + ["m"] * (len(action["names"]) - 6)
    assert len(action["names"]) > 6


@pytest.fixture(scope="module")
def mapped(tmp_path_factory):
    """The dataset of the same episodes as of an arm in degrees, from a camera with a name."""
    folder = tmp_path_factory.mktemp("mapped")
    names = [f"joint_{i}" for i in range(1, 7)]
    lines = [
        f'{n} = {{name = "{n}.pos", sign = -1, offset = 5, unit = "deg"}}'
        for n in names
    ]
    (folder / "map.toml").write_text("\n".join(["[joint_map]", *lines]))
    options = ["--camera", "front", "--joint-map", str(folder / "map.toml")]
    to = ["--episodes", str(COUNT), "--to", str(folder / "dataset")]
    assert main(["record", "oracle", *to, *options]) == 0
    return folder / "dataset"


def test_a_mapped_dataset_has_names_units_and_values_of_the_real_arm(mapped, frames):
    features = json.loads((mapped / "meta/info.json").read_text())["features"]
    assert features["action"]["names"][0] == "joint_1.pos"
    assert features["observation.state"]["units"] == ["deg"] * 6
    assert features["action.levels"]["names"][0] == "joint_1"
    assert "observation.images.front" in features
    found = pq.read_table(mapped / "data/chunk-000/file-000.parquet").to_pylist()
    for name in ("observation.state", "action"):
        degrees = 5 - np.degrees([frame[name] for frame in frames])
        np.testing.assert_allclose([frame[name] for frame in found], degrees, atol=1e-4)


def test_the_task_in_words_does_not_hold_the_answer(tmp_path):
    to = str(tmp_path / "choose")
    assert (
        main(
            ["record", "oracle", "--env.task", "choose", "--episodes", "2", "--to", to]
        )
        == 0
    )
    words = pq.read_table(tmp_path / "choose/meta/tasks.parquet").to_pylist()
    assert words
    assert not any(": the" in str(row) for row in words)


def test_a_folder_with_files_is_left_alone(dataset, capsys):
    before = (dataset / "meta/info.json").read_bytes()
    assert main(["record", "oracle", "--episodes", "1", "--to", str(dataset)]) == 2
    assert "not empty" in capsys.readouterr().err
    assert (dataset / "meta/info.json").read_bytes() == before


def test_the_real_lerobot_trains_with_quantiles(mapped):
    python = os.environ.get("KNOWARM_LEROBOT_PYTHON")
    if python is None:
        pytest.skip("KNOWARM_LEROBOT_PYTHON names no Python with lerobot")
    environment = os.environ | {"HF_HUB_OFFLINE": "1"}
    environment.pop("PYTHONPATH", None)
    command = [python, Path(__file__).with_name("lerobot_act.py"), mapped, "200"]
    done = subprocess.run(
        command, check=True, capture_output=True, text=True, env=environment
    )
    episodes, shape, first, last = done.stdout.split()
    assert (episodes, shape) == (str(COUNT), "3x64x64")
    assert 0 < float(last) < 0.8 * float(first)
