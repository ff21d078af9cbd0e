"""Environments are values: they are copied, pickled and set back, and play on as before."""

import copy
import hashlib
import pickle
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
import torch

import knowarm
from knowarm.errors import DataWarning, UserError
from tests.mujoco_version import LIFTS

SMALL = {"image_size": 16}
MADE = {
    "single": lambda: knowarm.make("irb120", colours="randomized", **SMALL),
    "of gymnasium": lambda: gymnasium.make("knowarm/TiagoChoose-v0", **SMALL),
    "with joints": lambda: knowarm.make("irb120", observe=("image", "joints"), **SMALL),
    "continuous": lambda: knowarm.make("irb120", action="continuous", **SMALL),
    "SAME_STEP": lambda: knowarm.make("irb120", 3, max_episode_steps=4, **SMALL),
    "NEXT_STEP": lambda: knowarm.make(
        "irb120", 3, autoreset_mode="NextStep", max_episode_steps=4, **SMALL
    ),
    "kinematic": lambda: knowarm.make("tiago", 3, dynamics="kinematic", **SMALL),
    "lifting": lambda: knowarm.make("tiago", 3, task="lift", **SMALL),
    "tensors": lambda: knowarm.make("irb120", 3, "cpu", max_episode_steps=4, **SMALL),
    "drawn by OpenGL": lambda: knowarm.make("irb120", 2, renderer="opengl", **SMALL),
}
MARKS = {"drawn by OpenGL": pytest.mark.opengl, "lifting": LIFTS}
CASES = [
    pytest.param(name, marks=[MARKS[name]] if name in MARKS else []) for name in MADE
]


def actions_of(env, count):
    """Draw actions, of the kind that the environment takes."""
    env.action_space.seed(0)
    drawn = [env.action_space.sample() for _ in range(count)]
    if isinstance(env, knowarm.TorchArmVectorEnv):
        return [torch.from_numpy(action) for action in drawn]
    return drawn


def as_bytes(value):
    """Return the bytes of arrays, tensors, numbers, and dictionaries and tuples of them."""
    if isinstance(value, dict):
        return as_bytes(tuple(value.values()))
    if isinstance(value, tuple):
        return b"".join(map(as_bytes, value))
    return np.asarray(value).tobytes()


def played(env, actions):
    """Return all that an environment says of some steps, as bytes."""
    said = []
    for action in actions:
        said.append(as_bytes(env.step(action)[:4]))
        said.append(as_bytes(env.unwrapped.get_state()))
    return said


@pytest.mark.parametrize("name", CASES)
def test_copies_and_the_state_play_on_to_the_byte(name):
    env = MADE[name]()
    env.reset(seed=5)
    first = actions_of(env, 9)
    played(env, first[:3])
    copies = [copy.deepcopy(env), pickle.loads(pickle.dumps(env))]
    state = env.unwrapped.get_state()
    rest = first[3:]
    expected = played(env, rest)
    assert len(set(expected)) == len(expected), "something moves"
    for other in copies:
        assert played(other, rest) == expected
    env.unwrapped.set_state(state)
    assert played(env, rest) == expected
    fresh = MADE[name]()
    fresh.reset(seed=8)
    fresh.unwrapped.set_state(state)
    assert played(fresh, rest) == expected


def test_a_copy_is_apart_from_its_original():
    env = knowarm.make("irb120", **SMALL)
    env.reset(seed=0)
    other = copy.deepcopy(env)
    before = env.joint_positions
    for _ in range(3):
        other.step(np.ones(6, int))
    np.testing.assert_array_equal(env.joint_positions, before)
    assert np.abs(other.joint_positions - before).max() > 0.05


def test_the_curriculum_and_the_teacher_are_copied():
    env = knowarm.make("irb120", 4, "cpu", **SMALL)
    env.reset(seed=0)
    env.threshold_factor = 3.0
    env.practice_share = 1.0
    env.report_privileged_state = True
    other = copy.deepcopy(env)
    for each in (env, other):
        each.reset(seed=1)
    assert other.threshold_factor == 3.0
    assert other.practice_share == 1.0
    torch.testing.assert_close(other.privileged_state, env.privileged_state)
    for mine, theirs in zip(env.teach(), other.teach(), strict=True):
        torch.testing.assert_close(mine, theirs)
    assert other.teacher._state is other.running


def test_another_process_plays_on(tmp_path):
    env = knowarm.make("irb120", **SMALL)
    env.reset(seed=0)
    env.step(np.ones(6, int))
    (tmp_path / "env").write_bytes(pickle.dumps(env))
    code = (
        "import pickle, sys, hashlib, numpy as np\n"
        "env = pickle.loads(open(sys.argv[1], 'rb').read())\n"
        "print(hashlib.sha256(env.step(np.ones(6, int))[0].tobytes()).hexdigest())\n"
        "import knowarm\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "env")],
        capture_output=True,
        text=True,
        check=True,
    )
    image = env.step(np.ones(6, int))[0]
    assert done.stdout.strip() == hashlib.sha256(image.tobytes()).hexdigest()


def test_a_state_of_another_environment_is_refused():
    env = knowarm.make("irb120", **SMALL)
    with pytest.raises(UserError, match="The state belongs to another environment"):
        env.set_state(knowarm.make("tiago", **SMALL).get_state())


def test_an_option_has_gymnasium_s_name_and_a_wrong_one_is_told_which():
    def options(text):
        return pytest.raises(UserError, match=text)

    with options("'autoreset'. Did you mean 'autoreset_mode'"):
        knowarm.make("irb120", 2, autoreset="NextStep")
    with options("Available: .*autoreset_mode.*device.*num_threads.*render_mode"):
        gymnasium.make_vec("knowarm/IRB120Reach-v0", num_envs=2, threads=2)
    with options("Available: .*render_mode"):
        knowarm.make("irb120", mode="human")
    for name, value in (
        ("autoreset_mode", "NextStep"),
        ("num_threads", 2),
        ("device", "cpu"),
    ):
        with options(f"{name} is an option of vector environments.*pass num_envs"):
            gymnasium.make("knowarm/IRB120Reach-v0", **{name: value})


@pytest.mark.parametrize("task", ["reach", pytest.param("lift", marks=LIFTS)])
@pytest.mark.parametrize("robot", knowarm.ROBOTS)
def test_the_bounds_of_the_joints_are_finite_and_hold_against_the_limits(robot, task):
    env = knowarm.make(
        robot, 16, task=task, image_size=8, observe=("joints",), mpi_rad=0.2
    )
    env.reset(seed=0)
    space = env.single_observation_space["joints"]
    assert np.isfinite(space.low).all()
    assert (space.low < env.scene.joint_lower).all()
    assert (space.high > env.scene.joint_upper).all()
    outwards = np.random.default_rng(0).integers(1, 3, env.action_space.shape)
    beyond = False
    for _ in range(45):
        observed = env.step(outwards)[0]
        assert env.observation_space.contains(observed)
        angles = env.joint_positions
        inside = (angles >= env.scene.joint_lower) & (angles <= env.scene.joint_upper)
        beyond = beyond or not inside.all()
    assert beyond, "some are pushed beyond their limits"


def test_a_success_distance_beyond_the_rectangle_is_questioned(recwarn):
    knowarm.make("irb120", image_size=8, success_distance_m=0.6)
    assert not recwarn
    for options in (
        {"success_distance_m": 2.0},
        {"num_envs": 2, "success_distance_m": 1.5},
        {"num_envs": 2, "device": "cpu", "success_distance_m": 0.64},
    ):
        with pytest.warns(
            DataWarning, match=r"rectangle of 0\.2 x 0\.6 m, and the succ"
        ):
            knowarm.make("irb120", image_size=8, **options)
    agent = knowarm.OracleAgent
    with pytest.warns(DataWarning, match="success distance of 0.7 m is longer"):
        knowarm.evaluate(
            agent, knowarm.EnvConfig(), episodes=1, probes=(), distance_m=0.7
        )
