import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import knowarm
from knowarm.errors import UserError
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.robots import ROBOTS
from knowarm.world.tasks.state import ACTION_LEVELS
from tests.world.helpers import MakeEnv

ALL_MODES = (AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED)


def random_actions(env: ArmVectorEnv, generator: np.random.Generator) -> np.ndarray:
    return generator.integers(len(ACTION_LEVELS), size=env.action_space.shape)


@pytest.mark.parametrize("dynamics", ["dynamic", "kinematic"])
@pytest.mark.parametrize("robot", ROBOTS)
def test_steps_give_what_the_spaces_promise(
    robot: str, dynamics: str, make_env: MakeEnv
) -> None:
    env = make_env(robot=robot, dynamics=dynamics, image_size=64)
    observations, infos = env.reset(seed=1)
    assert env.observation_space.contains(observations)
    assert observations.std(axis=(1, 2, 3)).min() > 5, "images show something"
    assert (infos["distance"] > 0.05).all()
    previous = observations
    for _ in range(3):
        actions = np.ones(env.action_space.shape, dtype=np.int64)
        observations, rewards, terminated, truncated, infos = env.step(actions)
        assert env.observation_space.contains(observations)
        assert (observations != previous).any(axis=(1, 2, 3)).all(), (
            "the arm is seen to move"
        )
        assert rewards == pytest.approx(
            -2 * infos["distance"] ** 2 - infos["angle"] / 70
        )
        assert not (terminated | truncated).any()
        previous = observations


def test_a_mode_of_autoreset_may_be_given_by_its_value(make_env: MakeEnv) -> None:
    env = knowarm.make(
        "irb120", num_envs=2, autoreset_mode="NextStep", image_size=8, num_threads=1
    )
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    with pytest.raises(UserError, match="got autoreset_mode 'NextStep'"):
        knowarm.make(
            "irb120", num_envs=2, autoreset_mode="NextStep", device="cpu", image_size=8
        )
    with pytest.raises(ValueError, match="'Never' is not a valid AutoresetMode"):
        knowarm.make("irb120", num_envs=2, autoreset_mode="Never", image_size=8)


@pytest.mark.parametrize("robot", ROBOTS)
def test_servos_follow_their_targets(robot: str, make_env: MakeEnv) -> None:
    env = make_env(8, robot=robot)
    env.reset(seed=0)
    generator = np.random.default_rng(0)
    lag = []
    for _ in range(12):
        env.step(random_actions(env, generator))
        lag.append(np.abs(env.joint_positions - env.joint_targets))
    assert np.mean(lag) < 0.01
    for _ in range(10):
        env.step(np.zeros(env.action_space.shape, dtype=np.int64))
    assert np.median(np.abs(env.joint_positions - env.joint_targets)) < 1e-4, "no sag"


def test_the_arm_does_not_go_through_the_floor(make_env: MakeEnv) -> None:
    env = make_env(4, dynamics="dynamic", mpi_rad=0.1)
    env.reset(seed=0)
    down = np.zeros((4, 6), dtype=np.int64)
    down[:, 1] = 1
    for _ in range(25):
        env.step(down)
    assert (env.joint_targets[:, 1] - env.joint_positions[:, 1] > 0.2).all(), (
        "it was stopped"
    )
    assert env.simulation.tcp_position[:, 2].min() > -0.01


@pytest.mark.parametrize("num_envs", [2, 64])
def test_an_episode_is_the_same_to_the_byte_at_any_number_of_environments_and_threads(
    num_envs: int, make_env: MakeEnv
) -> None:
    one, many = make_env(1), make_env(num_envs, num_threads=2)
    one.reset(seed=40 + num_envs - 1)
    many.reset(seed=40)
    generator = np.random.default_rng(0)
    for _ in range(60):  # past the end of the first episode
        action = generator.integers(7, size=(1, 6))
        alone = one.step(action)
        together = many.step(np.repeat(action, num_envs, axis=0))
        for a, b in zip(alone[:4], together[:4], strict=True):
            assert a[0].tobytes() == b[-1].tobytes()
        for name in ("distance", "angle", "target", "facet"):
            assert alone[4][name][0] == together[4][name][-1]


def test_facets_list_targets_with_their_possible_colours(make_env: MakeEnv) -> None:
    fixed = make_env(targets=("bottle", "mug"))
    assert fixed.facets == (("bottle", "yellow"), ("mug", "red"))
    env = make_env(40, colours="randomized")
    assert env.facets[2:4] == (("bottle", "yellow"), ("bottle", "purple"))
    _, infos = env.reset(seed=0)
    assert set(env.knowledge_input) == set(range(6))
    assert infos["facet"].tolist() == [
        "/".join(env.facets[i]) for i in env.knowledge_input
    ]
    assert (env.knowledge_input == infos["target"] * 2 + infos["colour"]).all()


def test_the_target_is_shown_in_its_colour_and_the_others_are_hidden(
    make_env: MakeEnv,
) -> None:
    env = make_env(60, colours="randomized", image_size=64)
    images, infos = env.reset(seed=0)
    red = (images[..., 0] > 120) & (images[..., 1] < 40) & (images[..., 2] < 40)
    blue = (images[..., 2] > 120) & (images[..., 0] < 40) & (images[..., 1] < 40)
    is_red = (infos["target"] == 0) & (infos["colour"] == 0)
    is_blue = (infos["target"] == 0) & (infos["colour"] == 1)
    assert (red.sum(axis=(1, 2))[is_red] > 10).all()
    assert (red.sum(axis=(1, 2))[~is_red] == 0).all()
    assert (blue.sum(axis=(1, 2))[is_blue] > 10).all()
    assert (blue.sum(axis=(1, 2))[~is_blue] == 0).all()


def test_same_step_autoreset_matches_gymnasium_s_own(make_env: MakeEnv) -> None:
    _compare_with_gymnasium(AutoresetMode.SAME_STEP, make_env)


def test_next_step_autoreset_matches_gymnasium_s_own(make_env: MakeEnv) -> None:
    _compare_with_gymnasium(AutoresetMode.NEXT_STEP, make_env)


def _compare_with_gymnasium(mode: AutoresetMode, make_env: MakeEnv) -> None:
    """Our vector against Gymnasium's SyncVectorEnv of single environments, value by value."""
    options = {"image_size": 16, "max_episode_steps": 4, "colours": "randomized"}
    theirs = gymnasium.vector.SyncVectorEnv(
        [lambda: gymnasium.make("knowarm/IRB120Reach-v0", **options)] * 3,
        autoreset_mode=mode,
    )
    ours = make_env(3, mode, **options)
    a, infos_a = ours.reset(seed=11)
    b, infos_b = theirs.reset(seed=11)
    assert (a == b).all()
    _same(infos_a, infos_b)
    generator = np.random.default_rng(1)
    # one environment is restarted early, so that not all end together
    mask = np.array([False, True, False])
    for step in range(14):
        if step == 2:
            a, _ = ours.reset(options={"reset_mask": mask})
            b, _ = theirs.reset(options={"reset_mask": mask})
            assert (a == b).all()
        actions = random_actions(ours, generator)
        *outs_a, infos_a = ours.step(actions)
        *outs_b, infos_b = theirs.step(actions)
        for x, y in zip(outs_a, outs_b, strict=True):
            assert (x == y).all()
        _same(infos_a, infos_b)


def _same(a: dict, b: dict) -> None:
    assert set(a) == set(b)
    for name, values in a.items():
        if isinstance(values, dict):
            _same(values, b[name])
        elif values.dtype.kind == "U":  # Gymnasium has None where there is no episode
            assert (values[a[f"_{name}"]] == b[name][b[f"_{name}"]]).all()
        elif values.dtype == object:
            for x, y in zip(values, b[name], strict=True):
                assert (x is None and y is None) or (x == y).all()
        else:
            assert (values == b[name]).all(), name


def test_a_finished_environment_must_be_reset_when_autoreset_is_off(
    make_env: MakeEnv,
) -> None:
    env = make_env(2, AutoresetMode.DISABLED, max_episode_steps=1)
    env.reset(seed=0)
    stay = np.zeros((2, 6), dtype=np.int64)
    env.step(stay)
    with pytest.raises(UserError, match="Environment 0 has no running episode: reset"):
        env.step(stay)
    env.reset(options={"reset_mask": np.array([True, True])})
    env.step(stay)


@pytest.mark.parametrize("mode", ALL_MODES)
def test_reset_without_a_seed_goes_on_in_the_stream(
    mode: AutoresetMode, make_env: MakeEnv
) -> None:
    env, other = make_env(2, mode), make_env(2, mode)
    for each in (env, other):
        each.reset(seed=3)
    one, two = env.reset()[1], other.reset()[1]
    assert (one["distance"] == two["distance"]).all()
    assert (one["distance"] != env.reset(seed=3)[1]["distance"]).all()
