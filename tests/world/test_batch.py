"""Batches of simulations: ``mujoco.batch`` and the loop in its place give the same bytes."""

import subprocess
import sys

import mujoco
import numpy as np
import pytest

import knowarm
from knowarm.errors import UserError
from knowarm.world import backend
from knowarm.world.batch import MUJOCO, LoopBatch
from tests.mujoco_version import LIFTS

TASKS = [
    ("irb120", "reach", "dynamic"),
    ("irb120", "reach", "kinematic"),
    ("tiago", "choose", "dynamic"),
    ("irb120", "purpose", "dynamic"),
    pytest.param("irb120", "lift", "dynamic", marks=LIFTS),
    pytest.param("tiago", "choose-lift", "dynamic", marks=LIFTS),
]


def walked(robot, task, dynamics, threads=2, count=6):
    """Return all that some random steps give, as bytes, and their rewards."""
    env = knowarm.make(
        robot,
        count,
        task=task,
        dynamics=dynamics,
        image_size=16,
        num_threads=threads,
        max_episode_steps=9,
    )
    env.reset(seed=0)
    generator = np.random.default_rng(0)
    seen = []
    rewards = 0.0
    for _ in range(25):
        image, reward, *_ = env.step(generator.integers(0, 7, env.action_space.shape))
        seen += [image.tobytes(), reward.tobytes(), env.joint_positions.tobytes()]
        rewards += reward.sum()
    seen.append(env.get_state()["simulation"].tobytes())
    return seen, rewards


@pytest.mark.skipif(MUJOCO < (3, 17), reason="MuJoCo before 3.17")
@pytest.mark.parametrize(("robot", "task", "dynamics"), TASKS)
def test_the_loop_gives_the_bytes_of_mujoco_batch(robot, task, dynamics, monkeypatch):
    native, _ = walked(robot, task, dynamics)
    assert backend.make_batch is not LoopBatch
    monkeypatch.setattr(backend, "make_batch", LoopBatch)
    assert walked(robot, task, dynamics)[0] == native


@pytest.mark.parametrize(("robot", "task", "dynamics"), TASKS)
def test_the_loop_gives_the_same_at_any_number_of_threads(
    robot, task, dynamics, monkeypatch
):
    monkeypatch.setattr(backend, "make_batch", LoopBatch)
    one = walked(robot, task, dynamics, threads=1)[0]
    assert walked(robot, task, dynamics, threads=4)[0] == one


@pytest.mark.parametrize(
    ("robot", "task", "rewards"),
    [
        ("irb120", "reach", -241.751458),
        ("tiago", "choose", -252.068118),
        ("irb120", "purpose", -262.833898),
    ],
)
def test_episodes_are_the_same_on_every_version_of_mujoco(robot, task, rewards):
    assert walked(robot, task, "dynamic")[1] == pytest.approx(rewards, abs=1e-5)


@pytest.mark.parametrize("version", ["3.8.1", "3.16.0"])
def test_files_that_a_newer_mujoco_left_are_not_read(version):
    code = (
        "import mujoco, sys\n"
        "sys.modules['mujoco.batch'] = None\n"
        f"mujoco.mj_versionString = lambda: {version!r}\n"
        "from knowarm.world import batch\n"
        "assert batch.make_batch is batch.LoopBatch\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_the_loop_has_fields_of_state_outputs_and_models():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><freejoint/><geom size='.1'/></body>"
        "<body mocap='true' name='m'/></worldbody></mujoco>"
    )
    batch = LoopBatch(model, 5, 2)
    height = batch.bind("qpos")[:, 2]
    batch.bind("mocap_pos")[:, 0] = [[0, 0, i] for i in range(5)]
    steps = batch.expand("opt.timestep")
    steps[:] = [0.001, 0.002, 0.003, 0.004, 0.005]
    positions = batch.bind("xpos")
    batch.step(nstep=10, stage=mujoco.mjtStage.mjSTAGE_POS)
    fallen = -9.81 * steps**2 * 55
    np.testing.assert_allclose(height, fallen)
    np.testing.assert_allclose(positions[:, 1, 2], fallen)
    np.testing.assert_allclose(positions[:, 2, 2], range(5))
    before = batch.state.copy()
    batch.expand("body_mass")[:, 1] = 2.0
    batch.step(np.array([3]), nstep=1, stage=mujoco.mjtStage.mjSTAGE_ACC)
    changed = (batch.state != before).any(1)
    assert changed.tolist() == [False, False, False, True, False]
    assert np.asarray(batch.bind("ncon")).shape == (5,)


def test_lifting_names_the_version_that_it_needs(monkeypatch):
    model = "knowarm.world.tasks.skills.lift.model"
    monkeypatch.setattr(f"{model}.mj_versionString", lambda: "3.8.1")
    monkeypatch.setattr(f"{model}.MUJOCO", (3, 8))
    with pytest.raises(UserError, match=r"MuJoCo 3\.16, and 3\.8\.1 is installed"):
        knowarm.make("irb120", task=knowarm.Lift(), targets=("mug", "bowl"))
