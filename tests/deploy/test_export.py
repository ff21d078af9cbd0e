"""Exported policies do what PyTorch does, without it, and refuse what does not fit."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from knowarm.deploy import runner as runner_module
from knowarm.deploy.runner import Runner, Start
from knowarm.experiment.load import load_agent
from knowarm.world.agents.play import play
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv

pytest.importorskip("onnxruntime")
pytest.importorskip("onnxscript")

ZOO = Path(__file__).parents[2] / "zoo"


@pytest.fixture(
    scope="module", params=["irb120-choose-subgraph-fast", "irb120-full-fast"]
)
def exported(request, exported_zoo):
    """A policy exported by the function, and one by the command."""
    return load_agent(ZOO / request.param), exported_zoo(request.param)


@pytest.mark.slow
@pytest.mark.parametrize(
    "exported",
    ["irb120-choose-subgraph-fast", "irb120-choose-answers-fast"],
    indirect=True,
)
def test_the_runner_takes_the_actions_of_pytorch(exported):
    trained, folder = exported
    runner = Runner.load(folder)
    episodes = evaluation_episodes(trained.config.env, 8, 3)
    env = ArmVectorEnv(trained.config.env, 1)
    theirs, ours = play(runner, env, episodes), play(trained.agent, env, episodes)
    assert len(ours.steps.actions) >= 100
    np.testing.assert_array_equal(theirs.steps.actions, ours.steps.actions)
    np.testing.assert_array_equal(theirs.success, ours.success)


def test_the_runner_needs_neither_pytorch_nor_this_package(exported, tmp_path):
    _, folder = exported
    code = """
import sys, numpy as np
sys.path.insert(0, sys.argv[1])
from runner import Runner, Start
r = Runner.load(sys.argv[1])
home = dict(zip(r.joint_names, r.contract["joints"]["home"]))
r.reset(Start(home, r.contract["knowledge"]["rows"][0]))
assert r.act({"image": np.zeros((1, 64, 64, 3), np.uint8)}).shape == (1, 6) == r.targets.shape
assert not {"torch", "knowarm", "mujoco"} & set(sys.modules)
"""
    subprocess.run([sys.executable, "-c", code, str(folder)], check=True, cwd=tmp_path)


def test_the_runner_imports_two_libraries():
    text = Path(runner_module.__file__).read_text()
    names = {
        (node.module if isinstance(node, ast.ImportFrom) else node.names[0].name).split(
            "."
        )[0]
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Import | ast.ImportFrom)
    }
    assert names - set(sys.stdlib_module_names) == {"numpy", "onnxruntime"}


def test_the_contract_says_what_the_robot_needs(exported):
    trained, folder = exported
    contract = json.loads((folder / "contract.json").read_text())
    joints = contract["joints"]
    assert len(joints["names"]) == len(joints["lower"]) == trained.policy.shape.joints
    assert contract["camera"]["size"] == trained.config.env.image_size
    assert len(contract["knowledge"]["rows"]) == len(np.load(folder / "knowledge.npy"))
    lower, upper = (
        np.array(contract["workspace_m"][end]) for end in ("lower", "upper")
    )
    assert (lower < upper).all()


IMAGE, ROW = np.zeros((64, 64, 3), np.uint8), "usedFor drinking"


@pytest.mark.parametrize(
    ("joints", "knowledge", "image", "words"),
    [
        ({}, ROW, IMAGE, "joints lack joint_1"),
        ({"joint_3": float("nan")}, ROW, IMAGE, "not finite"),
        ({"joint_3": 9.0}, ROW, IMAGE, "within the limits"),
        (None, "usedFor nothing", IMAGE, "knowledge must be a row"),
        (None, None, IMAGE, "knowledge must be a row"),
        (None, np.array([], np.int64), IMAGE, "1 episodes start, and 0 have names"),
        (None, ROW, IMAGE[:32], r"image must be \(1, 64, 64, 3\) uint8"),
        (None, ROW, IMAGE.astype(np.float32), "float32"),
    ],
)
def test_bad_input_is_refused_in_one_line(exported, joints, knowledge, image, words):
    runner = Runner.load(exported[1])
    home = dict(zip(runner.joint_names, runner.contract["joints"]["home"], strict=True))
    given = home if joints is None else (home | joints if joints else {})
    given = {
        name.replace("joint_1", runner.joint_names[0]): v for name, v in given.items()
    }

    if knowledge is not ROW and len(runner.contract["knowledge"]["rows"]) == 1:
        pytest.skip("an agent that always knows the same reads no row")

    def play():
        runner.reset(Start(given, knowledge))
        runner.act({"image": image[None]})

    with pytest.raises(
        ValueError, match=words.replace("joint_1", runner.joint_names[0])
    ) as error:
        play()
    assert "\n" not in str(error.value)


@pytest.fixture
def copied(exported, tmp_path):
    """An exported folder that may be damaged."""
    for file in filter(Path.is_file, exported[1].iterdir()):  # not __pycache__
        (tmp_path / file.name).write_bytes(file.read_bytes())
    return tmp_path


def test_a_changed_file_is_refused(copied):
    table = np.load(copied / "knowledge.npy")
    np.save(copied / "knowledge.npy", table + 1)
    with pytest.raises(ValueError, match="not the exported file"):
        Runner.load(copied)


@pytest.mark.parametrize("file", ["policy.onnx", "knowledge.npy"])
def test_no_file_without_a_digest_and_no_device_is_read(copied, file):
    contract = json.loads((copied / "contract.json").read_text())
    (copied / file).unlink()
    os.mkfifo(copied / file)
    with pytest.raises(ValueError, match="not the exported file"):
        Runner.load(copied)
    for digests in ({}, contract["digests"] | {"/etc/passwd": "0"}):
        (copied / "contract.json").write_text(
            json.dumps(contract | {"digests": digests})
        )
        with pytest.raises(ValueError, match=r"must state digests of policy\.onnx, "):
            Runner.load(copied)


def reverse(joints):
    joints["names"].reverse()


@pytest.mark.parametrize(
    "change",
    [
        lambda contract: contract["joints"].update(lower=[-9.0] * 6, upper=[9.0] * 6),
        lambda contract: contract["joints"].update(mpi=2.0, increments=[2.0] * 7),
        lambda contract: reverse(contract["joints"]),
        lambda contract: contract["workspace_m"].update(lower=[-9.0] * 3),
        lambda contract: contract["knowledge"]["rows"].append("more"),
        lambda contract: contract.update(control_period_s=0.01),
    ],
)
def test_another_contract_than_the_model_was_exported_with_is_refused(copied, change):
    contract = json.loads((copied / "contract.json").read_text())
    change(contract)
    (copied / "contract.json").write_text(json.dumps(contract))
    with pytest.raises(ValueError, match=r"contract\.json is not that of "):
        Runner.load(copied)
    for other in (contract | {"format": "knowarm-contract-99"}, [contract]):
        (copied / "contract.json").write_text(json.dumps(other))
        with pytest.raises(ValueError, match="no contract of the format"):
            Runner.load(copied)
