"""Every face of the reaching task keeps one contract and plays the same episodes."""

from typing import Any

import numpy as np
import pytest
import torch

from knowarm.errors import UserError
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.robots import ROBOTS
from knowarm.world.scene.appearance import VisualRandomization
from knowarm.world.tasks.held_out import HeldOut
from tests.world.faces import (
    COUNT,
    EPISODE_STEPS,
    FACES,
    METRICS,
    NUMPY,
    Face,
    check_infos,
    host,
    random_actions,
    shared_env,
)

EVERYTHING = VisualRandomization(
    light=0.3,
    light_angle_deg=15,
    camera_shift_m=0.05,
    camera_turn_deg=2,
    surface_colour=0.15,
    distractors=2,
)


@pytest.fixture(params=FACES)
def face(request: pytest.FixtureRequest) -> Face:
    return request.param


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest) -> str:
    return request.param


def compare(face: Face, env: Any, reference: Any, steps: int, seed: int) -> int:
    """Play both with the same random actions; compare everything; return how many ended."""
    generator, ended = np.random.default_rng(seed), 0
    everywhere = np.ones(env.num_envs, dtype=np.bool_)
    images, infos = env.reset(seed=seed)
    expected, expected_infos = reference.reset(seed=seed)
    assert (host(images) == expected).all()
    check_infos(infos, expected_infos, everywhere)
    for _ in range(steps):
        actions = random_actions(env, generator)
        images, reward, terminated, truncated, infos = env.step(face.actions(actions))
        expected, *judged, expected_infos = reference.step(actions)
        assert (host(images) == expected).all()
        assert (host(reward) == judged[0]).all()
        assert (host(terminated) == judged[1]).all()
        assert (host(truncated) == judged[2]).all()
        check_infos(infos, expected_infos, everywhere)
        assert (host(env.knowledge_input) == reference.knowledge_input).all()
        done, cut = judged[1] | judged[2], judged[2]
        ended += int(done.sum())
        if done.any():
            assert (host(infos["_final_info"]) == done).all()
            check_infos(infos["final_info"], expected_infos["final_info"], done)
        if cut.any():
            assert host(infos["_final_obs"])[cut].all()
            last = np.stack(list(expected_infos["final_obs"][cut]))
            given = infos["final_obs"]
            shown = np.stack([host(given[i]) for i in np.flatnonzero(cut)])
            assert (shown == last).all()
    return ended


def test_episodes_are_those_of_the_numpy_face(face: Face, robot: str) -> None:
    env, reference = shared_env(face, robot), NUMPY.make(robot=robot)
    assert compare(face, env, reference, 2 * EPISODE_STEPS + 2, seed=11) >= 2 * COUNT


@pytest.mark.parametrize(
    "options",
    [
        {"success_distance_m": 0.6, "success_angle_deg": 80.0, "dynamics": "kinematic"},
        {"randomization": EVERYTHING, "ignore_roll": True, "dynamics": "kinematic"},
        {
            "held_out": HeldOut(colours=("blue",), places=(0, 1, 0, 1)),
            "antialiasing": False,
        },
    ],
    ids=["success", "looks", "held_out"],
)
def test_every_option_is_that_of_the_numpy_face(face: Face, options: dict) -> None:
    env = face.make(**options)
    assert compare(face, env, NUMPY.make(**options), 16, seed=5) >= COUNT


def test_results_have_the_promised_types(face: Face, robot: str) -> None:
    env = shared_env(face, robot)
    images, infos = env.reset(seed=1)
    assert env.observation_space.contains(host(images))
    stay = face.actions(np.zeros(env.action_space.shape, dtype=np.int64))
    later, reward, terminated, truncated, infos = env.step(stay)
    assert later is not images
    assert env.observation_space.contains(host(later))
    assert (host(later) == host(images)).mean() > 0.8, "nothing moved"
    assert host(images).std() > 5, "the image is not uniform"
    assert host(terminated).dtype == host(truncated).dtype == np.bool_
    assert host(env.knowledge_input).dtype == np.int64
    for name in METRICS:
        assert host(infos[name]).shape == host(infos[f"_{name}"]).shape == (COUNT,)
    if face.device is None:
        assert reward.dtype == np.float64
        return
    assert later.data_ptr() != images.data_ptr(), "a new image at every call"
    assert host(reward).dtype == np.float64
    assert later.dtype == torch.uint8
    results = (
        later,
        reward,
        terminated,
        truncated,
        env.knowledge_input,
        infos["distance"],
    )
    assert all(values.device == env.device for values in results)


def test_actions_add_the_paper_s_increments_and_stop_at_the_range(face: Face) -> None:
    env = face.make(7, dynamics="kinematic", mpi_rad=0.2, max_episode_steps=99)
    env.reset(seed=0)
    start = host(env.joint_positions)
    env.step(face.actions(np.repeat(np.arange(7)[:, None], 6, axis=1)))
    expected = 0.2 * np.array([0, 1, -1, 0.1, -0.1, 0.01, -0.01])
    moved = host(env.joint_positions) - start
    assert moved == pytest.approx(np.repeat(expected[:, None], 6, axis=1), abs=1e-6)
    for _ in range(45):
        env.step(face.actions(np.ones((7, 6), dtype=np.int64)))
    upper = np.tile(env.scene.joint_upper, (7, 1))
    assert host(env.joint_positions)[:, :5] == pytest.approx(upper[:, :5], abs=1e-6)
    assert host(env.joint_targets)[:, :5] == pytest.approx(upper[:, :5], abs=1e-6)


def test_the_time_limit_truncates_and_success_terminates(face: Face) -> None:
    stay = face.actions(np.zeros((2, 6), dtype=np.int64))
    env = face.make(2, max_episode_steps=3, dynamics="kinematic")
    env.reset(seed=0)
    for expected in (False, False, True):
        _, _, terminated, truncated, _ = env.step(stay)
        assert not host(terminated).any()
        assert (host(truncated) == expected).all()
    easy = face.make(
        2,
        max_episode_steps=1,
        success_distance_m=2.0,
        success_angle_deg=181.0,
        dynamics="kinematic",
    )
    easy.reset(seed=0)
    _, reward, terminated, truncated, infos = easy.step(stay)
    assert host(terminated).all()
    assert not host(truncated).any(), "success in the last step is not a truncation"
    assert (host(reward) == 100).all()
    assert host(infos["final_info"]["is_success"]).all()


def test_seeds_select_streams(face: Face, robot: str) -> None:
    env, reference = shared_env(face, robot), shared_env(NUMPY, robot)
    for seed in (2**63 - 3, 2**64 - 2, [4, None, 9, 4, 1, None]):
        infos, expected = env.reset(seed=seed)[1], reference.reset(seed=seed)[1]
        given = np.array(
            [True] * 6 if isinstance(seed, int) else [s is not None for s in seed]
        )
        check_infos(infos, expected, given)
    first = host(env.reset(seed=1)[1]["distance"])
    assert (first != host(env.reset()[1]["distance"])).any(), "the stream continues"
    assert (first == host(env.reset(seed=1)[1]["distance"])).all()


def test_given_episodes_are_played_where_the_mask_is_set(
    face: Face, robot: str
) -> None:
    env, reference = shared_env(face, robot), shared_env(NUMPY, robot)
    env.reset(seed=3), reference.reset(seed=3)
    mask = np.array([True, False, False, True, True, False])
    episodes = evaluation_episodes(env.config, 3, seed=9)
    options = {"episodes": episodes, "reset_mask": mask}
    expected = reference.reset(options=options)[1]
    infos = env.reset(options=options)[1]
    check_infos(infos, expected, np.ones(6, dtype=np.bool_))
    assert (host(infos["target"])[mask] == episodes.target).all()
    assert host(env.joint_positions) == pytest.approx(
        reference.joint_positions, abs=1e-6
    )
    if face.device:
        env.reset(
            options=options | {"reset_mask": torch.as_tensor(mask, device=face.device)}
        )
    with pytest.raises(UserError, match="holds 3 episodes for 6 environments"):
        env.reset(options={"episodes": episodes})


def test_a_reset_leaves_the_other_environments_unchanged(
    face: Face, robot: str
) -> None:
    env = shared_env(face, robot)
    env.reset(seed=0)
    for _ in range(4):
        env.step(face.actions(np.ones(env.action_space.shape, dtype=np.int64)))
    before, positions = env.get_state(), host(env.joint_positions)
    mask = np.array([False, True, True, False, False, False])
    env.reset(options={"reset_mask": mask})
    after = env.get_state()
    for name, values in before.items():
        assert (after[name][~mask] == values[~mask]).all(), name
    assert (host(env.joint_positions)[~mask] == positions[~mask]).all()
    assert (after["steps"] == np.where(mask, 0, 4)).all()


def test_a_restored_state_continues_to_the_byte(face: Face, robot: str) -> None:
    env = shared_env(face, robot)
    generator = np.random.default_rng(2)
    env.reset(seed=8)
    for _ in range(7):
        env.step(face.actions(random_actions(env, generator)))
    state = env.get_state()
    assert all(isinstance(values, np.ndarray) for values in state.values())
    plan = [face.actions(random_actions(env, generator)) for _ in range(EPISODE_STEPS)]
    played = [env.step(actions)[:4] for actions in plan]
    env.reset(seed=77)
    env.step(plan[0])
    env.set_state(state)
    replayed = [env.step(actions)[:4] for actions in plan]
    for one, two in zip(played, replayed, strict=True):
        for a, b in zip(map(host, one), map(host, two), strict=True):
            assert a.tobytes() == b.tobytes()
    with pytest.raises(UserError, match="state belongs to another environment"):
        env.set_state({name: values[:3] for name, values in state.items()})


def test_returned_arrays_are_not_written_later(face: Face) -> None:
    env = face.make(dynamics="kinematic", max_episode_steps=3)
    kept = []
    generator = np.random.default_rng(0)
    kept.append(env.reset(seed=0))
    for _ in range(7):
        images, reward, terminated, truncated, infos = env.step(
            face.actions(random_actions(env, generator))
        )
        infos = {name: infos[name] for name in METRICS}
        kept.append(
            (images, infos | {"reward": reward, "ended": terminated | truncated})
        )
    copies = [
        (host(images), {n: host(v).copy() for n, v in d.items()})
        for images, d in kept[:4]
    ]
    env.reset(seed=5)
    for (images, infos), (copy, copied) in zip(kept, copies, strict=False):
        assert (host(images) == copy).all()
        for name, values in copied.items():
            assert (host(infos[name]) == values).all(), name


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (np.zeros((6, 5), dtype=np.int64), r"shape \(6, 6\)"),
        (np.zeros((6, 6)), "int"),
        (np.full((6, 6), 7), "0 to 6 of shape .*got 7"),
        (np.full((6, 6), -1), "0 to 6 of shape .*got -1"),
    ],
)
def test_wrong_actions_are_refused(
    face: Face, actions: np.ndarray, message: str
) -> None:
    env = shared_env(face, "irb120")
    env.reset(seed=0)
    with pytest.raises(UserError, match=message):
        env.step(face.actions(actions))


def test_seeds_may_be_integers_of_numpy(face: Face) -> None:
    env = shared_env(face, "irb120")
    expected = host(env.reset(seed=[3, 4, 5, 6, 7, 8])[0]).copy()
    for seed in (np.int64(3), np.arange(3, 9), [*np.arange(3, 9, dtype=np.int32)]):
        np.testing.assert_array_equal(host(env.reset(seed=seed)[0]), expected)


def test_wrong_seeds_masks_and_counts_are_refused(face: Face) -> None:
    env = shared_env(face, "irb120")
    for seed in ([1, 2, 3], 1.5, "1", [1, 2, 3, 4, 5, 6.5]):
        with pytest.raises(UserError, match="seed must be an integer or a list of 6"):
            env.reset(seed=seed)
    with pytest.raises(UserError, match="seed must not be negative"):
        env.reset(seed=-1)
    with pytest.raises(UserError, match="reset_mask"):
        env.reset(options={"reset_mask": np.zeros(6, dtype=np.bool_)})
    with pytest.raises(
        UserError, match="num_envs must be a whole number of at least 1, got 0"
    ):
        face.make(0)


def test_closing_twice_does_no_harm(face: Face) -> None:
    env = face.make(2, dynamics="kinematic")
    env.reset(seed=0)
    env.close()
    env.close()
