"""Policies of other libraries in the benchmark: ONNX files, Stable-Baselines3's models, servers."""

import shutil
import threading

import numpy as np
import pytest

from knowarm.benchmark.policies import PredictingPolicy, entrant
from knowarm.benchmark.suites import read_suite
from knowarm.errors import UserError
from knowarm.experiment.load import load_agent
from knowarm.fence import Fence
from knowarm.world.agents.play import play
from knowarm.world.envs.vector_env import ArmVectorEnv
from tests.source_tree import ROOT

CELL = read_suite("reach-v1").cells["irb120-fixed"]


def made_for(made, cell, count):
    """An agent of an entrant, and its environment."""
    env = ArmVectorEnv(cell.env, count)
    return made.make(cell, env), env


def actions_of(agent, count):
    """The actions (episodes, steps, J) of an agent in the first episodes of the cell."""
    env = ArmVectorEnv(CELL.env, count)
    result = play(agent, env, CELL.episodes[:count])
    return result.steps.actions


@pytest.fixture
def counting(tmp_path):
    """An ONNX file with a recurrent state: level k of every joint in step k, at most 6."""
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    from onnx import TensorProto, helper

    def tensor(name, kind, width):
        return helper.make_tensor_value_info(name, kind, ["n", width])

    nodes = [
        helper.make_node("Constant", [], ["one"], value_float=1.0),
        helper.make_node("Constant", [], ["six"], value_float=6.0),
        helper.make_node("Add", ["count", "one"], ["sum"]),
        helper.make_node("Min", ["sum", "six"], ["next"]),
        helper.make_node("Sub", ["joint_targets", "joint_targets"], ["none"]),
        helper.make_node("Add", ["none", "next"], ["raised"]),
        helper.make_node("Cast", ["raised"], ["levels"], to=TensorProto.INT64),
    ]
    graph = helper.make_graph(
        nodes,
        "counting",
        [
            tensor("joint_targets", TensorProto.FLOAT, 6),
            tensor("count", TensorProto.FLOAT, 1),
        ],
        [tensor("levels", TensorProto.INT64, 6), tensor("next", TensorProto.FLOAT, 1)],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)])
    model.ir_version = 9
    helper.set_model_props(model, {"training": "counts"})
    path = tmp_path / "counting.onnx"
    onnx.save(model, path)
    return path


def test_an_onnx_file_keeps_its_state_for_an_episode(counting):
    made = entrant(str(counting))
    assert (made.inputs, made.training, len(made.digest)) == ((), "counts", 64)
    agent, _ = made_for(made, CELL, 1)
    for _ in range(2):  # the second batch starts with a state of zeros again
        steps = actions_of(agent, 2).reshape(2, -1, 6)
        np.testing.assert_array_equal(steps[:, :8, 0], [[1, 2, 3, 4, 5, 6, 6, 6]] * 2)


def test_damaged_and_unfit_onnx_files_are_refused(counting, tmp_path):
    onnx = pytest.importorskip("onnx")
    model = onnx.load(counting)
    del model.graph.output[1]
    onnx.save(model, tmp_path / "lacks.onnx")
    with pytest.raises(UserError, match=r"one per state.*here count"):
        entrant(str(tmp_path / "lacks.onnx"))
    other = next(
        cell
        for cell in read_suite("reach-v1").cells.values()
        if cell.env.robot == "tiago"
    )
    with pytest.raises(
        UserError, match=r"counting\.onnx does not take joint_targets float32"
    ):
        play(*made_for(entrant(str(counting)), other, 1), other.episodes[:1])
    (tmp_path / "damaged.onnx").write_bytes(b"no model")
    with pytest.raises(UserError, match=r"damaged\.onnx is damaged"):
        entrant(str(tmp_path / "damaged.onnx"))


@pytest.fixture
def scoring(tmp_path):
    """Return a function that makes an ONNX file: the same scores in every step, and a state."""
    onnx = pytest.importorskip("onnx")
    from onnx import TensorProto, helper, numpy_helper

    def make(scores, width=1):
        scores = np.asarray(scores, np.float32).reshape(1, 6, -1)
        info = helper.make_tensor_value_info
        state = [
            info(name, TensorProto.FLOAT, ["n", width]) for name in ("count", "next")
        ]
        out = info("scores", TensorProto.FLOAT, [1, *scores.shape[1:]])
        nodes = [
            helper.make_node(
                "Constant", [], ["scores"], value=numpy_helper.from_array(scores)
            ),
            helper.make_node("Identity", ["count"], ["next"]),
        ]
        graph = helper.make_graph(nodes, "scoring", state[:1], [out, state[1]])
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)])
        model.ir_version = 9
        onnx.save(model, tmp_path / "scoring.onnx")
        return str(tmp_path / "scoring.onnx")

    return make


@pytest.mark.parametrize("scores", [np.full(42, np.nan), np.zeros(30), np.zeros(54)])
def test_scores_that_are_none_are_not_played(scoring, scores):
    assert (
        actions_of(made_for(entrant(scoring(np.zeros(42))), CELL, 1)[0], 1) == 0
    ).all()
    with pytest.raises(UserError, match=r"scores must be finite, \(n, J, 7\)"):
        actions_of(made_for(entrant(scoring(scores)), CELL, 1)[0], 1)


@pytest.mark.parametrize("width", ["wide", 10**12])
def test_a_state_without_a_size_that_fits_is_refused(scoring, width):
    with pytest.raises(
        UserError, match="All sizes of states but the first are numbers"
    ):
        actions_of(made_for(entrant(scoring(np.zeros(42), width)), CELL, 1)[0], 1)


class Continuous:
    """A model with ``predict``: increments in units of the MPI, a count as recurrent state."""

    num_timesteps, seed = 1234, 5

    def __init__(self):
        from gymnasium import spaces

        self.observation_space = spaces.Dict({"joint_targets": spaces.Box(-9, 9, (6,))})

    def predict(self, observation, state, episode_start, deterministic):
        assert deterministic
        assert set(observation) == {"joint_targets"}
        state = np.where(episode_start, 0, 0 if state is None else state + 1)
        increments = np.array([-0.9, 0.004, 0.02, 0.13, 2.0, -0.07])
        return np.where(state[:, None] == 0, increments, 0.0), state


def test_continuous_actions_are_played_as_the_nearest_levels():
    policy = PredictingPolicy(Continuous())
    assert (policy.inputs, policy.training, policy.seed) == (
        (),
        "Continuous, 1,234 steps",
        5,
    )
    steps = actions_of(policy, 1)
    np.testing.assert_array_equal(steps[0], [2, 0, 5, 3, 1, 4])
    assert (steps[1:] == 0).all()


def test_a_model_of_other_observations_is_refused():
    from gymnasium import spaces

    model = Continuous()
    model.observation_space = spaces.Dict(
        {"image": spaces.Box(0, 255, (2,)), "knowledge": spaces.Box(0, 1, (2,))}
    )
    with pytest.raises(
        UserError, match="The Continuous observes knowledge; the benchmark gives"
    ):
        PredictingPolicy(model)


def test_a_saved_model_of_sb3_plays(tmp_path):
    sb3 = pytest.importorskip("stable_baselines3")
    from knowarm.learn.sb3_vec_env import SB3VecEnv

    env = SB3VecEnv(ArmVectorEnv(CELL.env, 1))
    sb3.PPO("CnnPolicy", env, n_steps=2, batch_size=2, seed=3).save(
        tmp_path / "model.zip"
    )
    made = entrant(f"stable_baselines3:PPO:{tmp_path / 'model.zip'}")
    assert (made.inputs, made.training, made.seed) == (("image",), "PPO, 0 steps", 3)
    assert actions_of(made_for(made, CELL, 1)[0], 2).shape == (100, 6)
    with pytest.raises(UserError, match="Cannot make the policy"):
        entrant(f"stable_baselines3:PPO:{tmp_path / 'other.zip'}")


def test_an_exported_policy_acts_as_the_same_policy_here(
    tmp_path, monkeypatch, exported_zoo
):
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    trained = load_agent(ROOT / "zoo/irb120-full-fast")
    shutil.copytree(exported_zoo("irb120-full-fast"), tmp_path, dirs_exist_ok=True)
    started = []
    start = Fence._start
    monkeypatch.setattr(
        Fence, "_start", lambda fence: started.append(fence) or start(fence)
    )
    made = entrant(str(tmp_path))
    for count in (3, 2):
        local = actions_of(trained.agent, count)
        np.testing.assert_array_equal(
            actions_of(made_for(made, CELL, 1)[0], count), local
        )
    assert len(started) == 1, "runners share the model"
    contract = (tmp_path / "contract.json").read_text()
    for text in (
        "{}",
        contract[:-9],
        contract.replace('"digests": {', '"digests": {"x.onnx": "",'),
    ):
        (tmp_path / "contract.json").write_text(text)
        with pytest.raises(UserError, match="Export the policy again"):
            entrant(str(tmp_path))


def angles_of(agent, count):
    """The joint angles (episodes, steps, J) of an agent in the first episodes of the cell."""
    env = ArmVectorEnv(CELL.env, count)
    return play(agent, env, CELL.episodes[:count]).steps.joint_positions


def test_a_served_policy_acts_as_the_same_policy_here():
    pytest.importorskip("websockets")
    pytest.importorskip("msgpack")
    from knowarm.deploy.contract import deployment
    from knowarm.deploy.serve import PolicyServer

    trained = load_agent(ROOT / "zoo/irb120-full-fast")
    server = PolicyServer(deployment(trained).runner, port=0)
    threading.Thread(target=server.run, daemon=True).start()
    made = entrant(f"ws://127.0.0.1:{server.port}")
    try:
        for count in (2, 3):  # connections are used again, each episode starts anew
            local = angles_of(trained.agent, count)
            served = angles_of(made_for(made, CELL, 1)[0], count)
            np.testing.assert_array_equal(served, local)
        wrong = read_suite("reach-v1").cells["tiago-fixed"]
        with pytest.raises(UserError, match=r"moves other joints than"):
            play(*made_for(made, wrong, 1), wrong.episodes[:1])
    finally:
        server.close()
    with pytest.raises(UserError, match=r"The policy server at ws://.* has gone"):
        actions_of(made_for(made, CELL, 1)[0], 2)
    with pytest.raises(UserError, match="No policy server answers"):
        entrant("ws://127.0.0.1:1")
