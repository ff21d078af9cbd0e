"""MuJoCo Warp's poses are those of ``mujoco.batch``, step for step."""

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
import torch

from knowarm.world.arrays import IndexSelection, MaskSelection
from knowarm.world.backends.mujoco import MujocoSimulator
from knowarm.world.backends.warp import ROWS_PER_WORLD, WarpSimulator, capacity
from knowarm.world.config import EnvConfig
from knowarm.world.episodes import evaluation_episodes
from knowarm.world.scene import Scene, load_scene
from tests.devices import DEVICES
from tests.world.faces import CUDA, WARP, shared_env

TARGETS = ("mug", "bottle", "cereal_box")


def pose_error(host: MujocoSimulator, device: WarpSimulator) -> np.ndarray:
    """Largest difference of any pose of each environment, [m] or of a matrix, (n,)."""
    n = len(host.geom_position)
    differences = [
        np.abs(got.cpu().numpy().reshape(n, -1) - expected.reshape(n, -1)).max(axis=1)
        for expected, got in (
            (host.geom_position, device.geom_position),
            (host.geom_matrix, device.geom_matrix),
            (host.tcp_position, device.tcp_position),
            (host.tcp_matrix, device.tcp_matrix),
        )
    ]
    return np.max(differences, axis=0)


def both(
    scene: Scene, device: str, dynamics: str, count: int
) -> tuple[MujocoSimulator, WarpSimulator, np.ndarray]:
    """Start both simulators at the same episodes; return them and the joint angles."""
    episodes = evaluation_episodes(scene, EnvConfig(robot=scene.robot.name), count, seed=0)
    joints = scene.home + episodes.joint_offsets
    places = np.repeat(episodes.position[:, None], len(scene.targets), axis=1)
    host = MujocoSimulator(scene, count, 1, dynamics)
    host.reset(IndexSelection(np.arange(count)), joints, places)
    other = WarpSimulator(scene, count, torch.device(device), dynamics)
    start = torch.as_tensor(joints, dtype=torch.float32, device=device)
    every = torch.ones(count, dtype=torch.bool, device=device)
    other.reset(MaskSelection(every), start, torch.as_tensor(places, device=device))
    assert pose_error(host, other).max() < 1e-5
    return host, other, joints


@pytest.mark.parametrize("dynamics", ["dynamic", "kinematic"])
@pytest.mark.parametrize("robot", ["irb120", "tiago"])
@pytest.mark.parametrize("device", DEVICES)
def test_poses_after_fifty_random_steps(robot: str, dynamics: str, device: str) -> None:
    scene = load_scene(robot, TARGETS)
    host, other, targets = both(scene, device, dynamics, count=8)
    generator = np.random.default_rng(1)
    for _ in range(50):
        steps = generator.choice([0, 0.1, -0.1, 0.01, -0.01, 0.001, -0.001], size=targets.shape)
        targets = np.clip(targets + steps, scene.joint_lower, scene.joint_upper)
        host.step(targets)
        other.step(torch.as_tensor(targets, dtype=torch.float32, device=device))
    assert pose_error(host, other).max() < 1e-4
    assert other.joint_positions.cpu().numpy() == pytest.approx(host.joint_positions, abs=1e-4)


@pytest.mark.parametrize("dynamics", ["dynamic", "kinematic"])
def test_a_replayed_graph_computes_the_bits_of_single_launches(
    dynamics: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On the CPU only: on a GPU the solver sums in any order."""
    scene, device, count = load_scene("irb120", TARGETS), "cpu", 5

    def single(simulator: WarpSimulator, run: Callable[[], None]) -> Callable[[], None]:
        def launch() -> None:
            with simulator._warp.ScopedDevice(simulator._warp_device):
                run()

        return launch

    _, graph, targets = both(scene, device, dynamics, count)
    with monkeypatch.context() as patched:
        patched.setattr(WarpSimulator, "_prepared", single)
        _, executed, _ = both(scene, device, dynamics, count)
    launches: list[Any] = []
    launch = graph._warp.launch
    monkeypatch.setattr(
        graph._warp, "launch", lambda *args, **opts: (launches.append(args), launch(*args, **opts))
    )
    generator = np.random.default_rng(2)
    for _ in range(8):
        targets = targets + generator.choice([0.1, -0.1], size=targets.shape)
        step = torch.as_tensor(targets, dtype=torch.float32, device=device)
        launches.clear()
        graph.step(step)
        assert not launches, "the graph was replayed"
        executed.step(step)
        assert len(launches) >= 1
        assert (graph.get_state() == executed.get_state()).all()
        for name in ("geom_position", "geom_matrix", "tcp_position", "tcp_matrix"):
            assert torch.equal(getattr(graph, name), getattr(executed, name)), name


@pytest.mark.parametrize("device", DEVICES)
def test_fingers_stop_at_the_table_as_on_the_cpu(device: str) -> None:
    """A box on a box has several contacts; with one alone, arms slid away by centimetres."""
    scene = load_scene("tiago", TARGETS)
    host, other, targets = both(scene, device, "dynamic", count=8)
    # Directions that press the fingers on the table, found by trying.
    signs = np.random.default_rng(1).choice([-1, 1], size=(256, scene.num_joints))[PRESSING]
    touched = np.zeros(len(signs), dtype=np.bool_)
    data = mujoco.MjData(scene.model)
    for _ in range(6):
        targets = np.clip(targets + 0.1 * signs, scene.joint_lower, scene.joint_upper)
        host.step(targets)
        other.step(torch.as_tensor(targets, dtype=torch.float32, device=device))
        for i, angles in enumerate(host.joint_positions):
            data.qpos[scene.qpos_index] = angles
            mujoco.mj_fwdPosition(scene.model, data)
            touched[i] |= data.ncon > 1
    assert touched.sum() >= 4
    assert pose_error(host, other).max() < 1e-4


PRESSING = [53, 113, 177, 227, 247, 251, 0, 1]


@pytest.mark.parametrize("device", DEVICES)
def test_too_many_contacts_are_reported_once(device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = shared_env(CUDA if device == "cuda" else WARP, "irb120").simulation
    monkeypatch.setattr(simulation, "_warned", False)
    simulation._overflow[1] = 1
    still = simulation.joint_positions

    def step_thrice() -> None:
        for _ in range(3):
            simulation.step(still)
            if simulation.device.type == "cuda":
                torch.cuda.synchronize()

    with pytest.warns(RuntimeWarning, match="NEFC overflowed in at least one world") as seen:
        step_thrice()
    assert len(seen) == 1
    simulation._overflow.zero_()
    simulation.step(still)


@pytest.mark.parametrize("robot", ["irb120", "tiago"])
def test_capacity_follows_the_model(robot: str) -> None:
    model = load_scene(robot, TARGETS).model
    one, many = capacity(model, 1), capacity(model, 1000)
    assert one.rows == many.rows == ROWS_PER_WORLD
    assert 900 * 32 < many.contacts < 1100 * 32
    # A single world may hold all the contacts that it can have.
    assert one.contacts > 16 * 8
    bare = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint/><geom size='.1'/></body></worldbody></mujoco>"
    )
    assert capacity(bare, 10).contacts == 0
    assert capacity(bare, 10).rows == 3
