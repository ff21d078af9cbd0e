"""Tensors on a device play what NumPy plays: episodes, poses, rewards and images."""

import numpy as np
import pytest
import torch
from device_pairs import EPISODE_STEPS, Pair, make_pair, shared_pair

from knowarm.errors import UserError
from knowarm.world.episodes import evaluation_episodes
from knowarm.world.held_out import HeldOut
from knowarm.world.torch_env import TorchReachVectorEnv
from knowarm.world.visual_randomization import VisualRandomization
from tests.devices import DEVICES

METRICS = ("distance", "angle", "target", "colour", "facet", "is_success")
EVERYTHING = VisualRandomization(
    light=0.3,
    light_angle_deg=15,
    camera_shift_m=0.05,
    camera_turn_deg=2,
    surface_colour=0.15,
    distractors=2,
)


@pytest.fixture(params=DEVICES)
def device(request: pytest.FixtureRequest) -> str:
    return request.param


@pytest.fixture(params=["irb120", "tiago"])
def pair(request: pytest.FixtureRequest, device: str) -> Pair:
    return shared_pair(device, request.param)


def numpy(tensor: torch.Tensor) -> np.ndarray:
    return tensor.cpu().numpy()


def actions_of(pair: Pair, generator: np.random.Generator) -> tuple[np.ndarray, torch.Tensor]:
    actions = generator.integers(7, size=pair.host.action_space.shape)
    return actions, torch.as_tensor(actions, device=pair.device.device)


def same_infos(host: dict, device: dict, where: np.ndarray) -> None:
    assert set(device) >= {name for metric in METRICS for name in (metric, f"_{metric}")}
    for name in METRICS:
        assert numpy(device[name])[where] == pytest.approx(host[name][where], abs=2e-4), name
        assert (numpy(device[f"_{name}"]) == host[f"_{name}"]).all()


def play(pair: Pair, steps: int, seed: int) -> int:
    """Play both with the same random actions, comparing everything; return how many ended."""
    generator, ended = np.random.default_rng(seed), 0
    observation, infos = pair.host.reset(seed=seed)
    drawn, measured = pair.device.reset(seed=seed)
    everywhere = np.ones(pair.host.num_envs, dtype=np.bool_)
    same_infos(infos, measured, everywhere)
    for _ in range(steps):
        actions, tensor = actions_of(pair, generator)
        observation, reward, terminated, truncated, infos = pair.host.step(actions)
        drawn, rewarded, done, cut, measured = pair.device.step(tensor)
        assert (drawn.dtype, rewarded.dtype) == (torch.uint8, torch.float32)
        assert (done.dtype, cut.dtype) == (torch.bool, torch.bool)
        assert numpy(rewarded) == pytest.approx(reward, abs=2e-5)
        assert (numpy(done) == terminated).all()
        assert (numpy(cut) == truncated).all()
        same_infos(infos, measured, everywhere)
        assert (numpy(pair.device.facet_ids) == pair.host.facet_ids).all()
        # Poses are float32 here: an edge may fall on the other side of a sample's ray.
        assert (numpy(drawn) != observation).any(axis=-1).mean() < 0.01
        assert (numpy(measured["_final_info"]) == terminated | truncated).all()
        assert (numpy(measured["_final_obs"]) == truncated).all()
        if (terminated | truncated).any():
            ended += int((terminated | truncated).sum())
            same_infos(infos["final_info"], measured["final_info"], terminated | truncated)
        if truncated.any():
            last = np.stack(list(infos["final_obs"][truncated]))
            shown = numpy(measured["final_obs"])[truncated]
            assert (shown != last).any(axis=-1).mean() < 0.01
    return ended


def test_whole_episodes_are_those_of_the_cpu(pair: Pair) -> None:
    assert play(pair, 2 * EPISODE_STEPS + 2, seed=11) >= 2 * pair.host.num_envs


@pytest.mark.parametrize(
    "options",
    [
        {"success_distance_m": 0.6, "success_angle_deg": 80.0, "dynamics": "kinematic"},
        {"randomization": EVERYTHING, "ignore_roll": True, "dynamics": "kinematic"},
        {"held_out": HeldOut(colours=("blue",), places=(0, 1, 0, 1)), "antialiasing": False},
    ],
    ids=["success", "looks", "held_out"],
)
def test_every_kind_of_task_is_that_of_the_cpu(options: dict, device: str) -> None:
    pair = make_pair(device, **options)
    assert play(pair, 16, seed=5) >= pair.host.num_envs
    if "success_distance_m" in options:
        *_, terminated, truncated, infos = pair.device.step(
            torch.zeros(pair.host.action_space.shape, dtype=torch.int64, device=device)
        )
        assert not (terminated & truncated).any()
        assert infos["_final_obs"].equal(truncated)


def test_seeds_reach_episodes_of_any_stream_and_number(pair: Pair) -> None:
    for seed in (2**63 - 3, 2**64 - 2, [4, None, 9, 4, 1, None]):
        infos, measured = pair.host.reset(seed=seed)[1], pair.device.reset(seed=seed)[1]
        given = np.array([True] * 6 if isinstance(seed, int) else [s is not None for s in seed])
        same_infos_where = {name: infos[name][given] for name in METRICS}
        for name in METRICS:
            got = numpy(measured[name])[given]
            assert got == pytest.approx(same_infos_where[name], abs=2e-4), name
    first = pair.device.reset(seed=1)[1]["distance"]
    assert not first.equal(pair.device.reset()[1]["distance"]), "the stream goes on"
    assert first.equal(pair.device.reset(seed=1)[1]["distance"])


def test_given_episodes_are_played_where_the_mask_is(pair: Pair) -> None:
    host, device = pair.host, pair.device
    host.reset(seed=3), device.reset(seed=3)
    mask = np.array([True, False, False, True, True, False])
    episodes = evaluation_episodes(host.scene, host.config, 3, seed=9)
    for given in (mask, torch.as_tensor(mask)):
        options = {"episodes": episodes, "reset_mask": given}
        infos = host.reset(options={"episodes": episodes, "reset_mask": mask})[1]
        measured = device.reset(options=options)[1]
        same_infos(infos, measured, np.ones(6, dtype=np.bool_))
    assert numpy(device.joint_positions) == pytest.approx(host.joint_positions, abs=1e-6)
    with pytest.raises(UserError, match="holds 3 episodes for 6 environments"):
        device.reset(options={"episodes": episodes})
    with pytest.raises(UserError, match="reset_mask"):
        device.reset(options={"reset_mask": torch.zeros(6, dtype=torch.bool)})


def test_an_environment_that_goes_on_is_not_disturbed_by_those_that_begin(pair: Pair) -> None:
    device = pair.device
    device.reset(seed=0)
    for _ in range(4):
        device.step(
            torch.ones(pair.host.action_space.shape, dtype=torch.int64, device=device.device)
        )
    before, positions = device.get_state(), device.joint_positions
    mask = torch.tensor([False, True, True, False, False, False])
    images = device.reset(options={"reset_mask": mask})[0]
    after = device.get_state()
    kept = ~mask.numpy()
    for name, values in before.items():
        assert (after[name][kept] == values[kept]).all(), name
    assert device.joint_positions[kept].equal(positions[kept])
    assert (after["steps"] == np.where(kept, 4, 0)).all()
    assert images.float().std() > 5


def test_state_goes_on_to_the_byte(pair: Pair) -> None:
    device = pair.device
    generator = np.random.default_rng(2)
    device.reset(seed=8)
    for _ in range(7):
        device.step(actions_of(pair, generator)[1])
    state = device.get_state()
    assert all(isinstance(values, np.ndarray) for values in state.values())
    plan = [actions_of(pair, generator)[1] for _ in range(EPISODE_STEPS)]
    played = [device.step(actions) for actions in plan]
    device.reset(seed=77)
    device.step(plan[0])
    device.set_state(state)
    again = [device.step(actions) for actions in plan]
    exact = device.device.type == "cpu"  # on a GPU sums are taken in any order
    for one, two in zip(played, again, strict=True):
        for a, b in zip(one[:4], two[:4], strict=True):
            assert a.equal(b) if exact else a.float().sub(b.float()).abs().mean() < 1
    other = {name: values[:3] for name, values in state.items()}
    with pytest.raises(UserError, match="state is of another environment"):
        device.set_state(other)


def test_spaces_and_results_are_what_gymnasium_promises(pair: Pair) -> None:
    device, host = pair.device, pair.host
    assert device.observation_space == host.observation_space
    assert device.action_space == host.action_space
    assert device.facets == host.facets
    observation, _ = device.reset(seed=0)
    assert device.observation_space.contains(numpy(observation))
    assert observation.device == device.device
    stay = torch.zeros(host.action_space.shape, dtype=torch.int64, device=device.device)
    later = device.step(stay)[0]
    assert later.data_ptr() != observation.data_ptr(), "a new image at every call"


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (torch.zeros((6, 2), dtype=torch.int64), "actions must be an int64 tensor of shape"),
        (torch.zeros((6, 6)), "got torch.float32"),
        (np.zeros((6, 6), dtype=np.int64), "got ndarray"),
    ],
)
def test_bad_actions_are_refused(actions: object, message: str, pair: Pair) -> None:
    with pytest.raises(UserError, match=message):
        pair.device.step(actions)


def test_actions_out_of_range_are_refused_on_the_cpu() -> None:
    env = TorchReachVectorEnv(
        make_pair("cpu", 2, dynamics="kinematic").host.config, 2, device="cpu", simulator="warp"
    )
    env.reset(seed=0)
    with pytest.raises(UserError, match="0 to 6, got 0 to 7"):
        env.step(torch.tensor([[0] * 5 + [7]] * 2))


def test_an_environment_is_closed_once(device: str) -> None:
    env = make_pair(device, 2, dynamics="kinematic").device
    env.reset(seed=0)
    env.close()
    env.close()
