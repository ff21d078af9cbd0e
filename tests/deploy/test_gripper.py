"""Policies that close fingers leave the simulator with them: same actions, same outcomes."""

import json
import re
import subprocess
import sys
import threading
from functools import partial

import numpy as np
import pyarrow.parquet as pq
import pytest
from gymnasium.vector import AutoresetMode

from knowarm.cli.main import main
from knowarm.deploy.contract import deployment, tcp_position
from knowarm.deploy.driver import Driver, Safety
from knowarm.deploy.joint_map import real_joints
from knowarm.deploy.runner import JointMap, Runner, Start
from knowarm.errors import UserError
from knowarm.experiment.load import load_agent
from knowarm.world.agents.play import play
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.robots import ROBOTS
from knowarm.world.robots.robot import RealJoint
from knowarm.world.scene.scene import Fingers
from tests.deploy.test_driver import CONTRACT
from tests.deploy.test_joint_map import scene_with
from tests.source_tree import ROOT

RUN = ROOT / "zoo" / "tiago-lift-full-distil"
IMAGE = np.zeros((64, 64, 3), np.uint8)


@pytest.fixture(scope="module")
def trained():
    return load_agent(RUN)


@pytest.fixture(scope="module")
def exported(exported_zoo):
    """The folder that the command writes."""
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    return exported_zoo(RUN.name)


@pytest.fixture(scope="module")
def env(trained):
    return ArmVectorEnv(trained.config.env, 8)


@pytest.fixture(scope="module")
def episodes(trained):
    return evaluation_episodes(trained.config.env, 16, 3)


@pytest.fixture(scope="module")
def played(trained, env, episodes):
    """The episodes as the policy plays them in process."""
    results = play(trained.agent, env, episodes)
    assert results.success.mean() > 0.8
    return results


def assert_plays_alike(results, played):
    """The same path of arm and fingers to the byte, and the same end of every episode."""
    ours, theirs = played.steps.joint_positions, results.steps.joint_positions
    np.testing.assert_array_equal(theirs, ours)
    np.testing.assert_array_equal(results.success, played.success)
    np.testing.assert_array_equal(results.infos["rise"], played.infos["rise"])


@pytest.fixture
def runner(trained):
    return deployment(trained).runner()


def home_of(runner, **changes):
    home = runner.contract["joints"]["home"]
    return dict(zip(runner.joint_names, home, strict=True)) | changes


@pytest.mark.slow
def test_the_exported_runner_lifts_as_the_policy_does(exported, env, episodes, played):
    results = play(Runner.load(exported), env, episodes)
    np.testing.assert_array_equal(results.steps.actions, played.steps.actions)
    assert_plays_alike(results, played)


def test_the_contract_says_what_a_gripper_needs(exported, trained):
    joints = json.loads((exported / "contract.json").read_text())["joints"]
    gripper = joints["gripper"]
    assert joints["names"][-1] == gripper["joint"] == "fingers"
    assert len(joints["lower"]) == trained.policy.shape.joints == 8
    assert joints["lower"][-1] == joints["home"][-1] == joints["start_offset"][-1] == 0
    assert gripper["closed"] == pytest.approx(0.039)
    assert joints["upper"][-1] == pytest.approx(0.039 + 0.02)
    assert gripper["unit"].startswith("m of each finger")
    assert (gripper["mpi"], gripper["force_n"]) == (joints["mpi"], 40.0)


def test_an_arm_alone_has_no_gripper(trained):
    alone = deployment(load_agent(ROOT / "zoo" / "tiago-full-fast"))
    assert "gripper" not in alone.contract["joints"]
    with pytest.raises(ValueError, match="moves no gripper"):
        alone.runner().closed(np.zeros((1, 7)))


def test_the_runner_of_a_gripper_needs_no_package(exported, tmp_path):
    code = """
import sys, numpy as np
sys.path.insert(0, sys.argv[1])
from runner import Runner, Start
r = Runner.load(sys.argv[1])
r.reset(Start(dict(zip(r.joint_names, r.contract["joints"]["home"]))))
assert r.closed(r.targets).tolist() == [0.0]
r.act({"image": np.zeros((1, 64, 64, 3), np.uint8)})
assert r.targets.shape == (1, 8) and 0 <= r.closed(r.targets)[0] <= 1
assert not {"torch", "knowarm", "mujoco"} & set(sys.modules)
"""
    command = [sys.executable, "-c", code, str(exported)]
    subprocess.run(command, check=True, cwd=tmp_path)


@pytest.mark.parametrize(
    ("metres", "share"),
    [(0.0, 0.0), (0.0195, 0.5), (0.039, 1.0), (0.059, 1.0)],
)
def test_targets_close_from_0_to_1(runner, metres, share):
    targets = np.zeros((3, 8))
    targets[1, -1] = metres
    np.testing.assert_allclose(runner.closed(targets), [0, share, 0], atol=1e-9)


@pytest.mark.parametrize("metres", [-0.01, 0.078, 1.0, 100.0, float("nan")], ids=str)
def test_a_start_that_counts_the_fingers_otherwise_is_refused(runner, metres):
    """As a gap of both fingers, as 0 to 1, in per cent, or with the other sign."""
    with pytest.raises(ValueError, match="not finite and within the limits"):
        runner.reset(Start(home_of(runner, fingers=metres)))
    runner.reset(Start(home_of(runner, fingers=0.041)))


def test_a_start_without_the_fingers_is_refused(runner):
    angles = home_of(runner)
    del angles["fingers"]
    with pytest.raises(ValueError, match="joints lack fingers"):
        runner.reset(Start(angles))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"joint": "jaw"}, "the gripper is one of its joints"),
        ({"closed": 0.0}, "larger than 0"),
        ({"closed": float("nan")}, "numbers are finite"),
    ],
    ids=str,
)
def test_a_damaged_gripper_moves_nothing(trained, change, words):
    contract = deployment(trained).contract
    joints = contract["joints"]
    damaged = joints | {"gripper": joints["gripper"] | change}
    with pytest.raises(ValueError, match=words):
        Runner(contract | {"joints": damaged}, np.zeros((1, 0)), lambda inputs: ())


@pytest.fixture
def url(trained):
    """The address of a server of the policy."""
    pytest.importorskip("websockets")
    pytest.importorskip("msgpack")
    from knowarm.deploy.serve import PolicyServer

    server = PolicyServer(deployment(trained).runner, port=0)
    threading.Thread(target=server.run, daemon=True).start()
    yield f"ws://127.0.0.1:{server.port}"
    server.close()


@pytest.mark.slow
def test_the_served_policy_lifts_as_the_policy_does(url, env, episodes, played):
    """A client finds levels that lead to the same targets; at a limit several do."""
    from knowarm.deploy.client import Client

    assert_plays_alike(play(Client(url), env, episodes), played)


@pytest.mark.parametrize(
    ("state", "words"),
    [
        (np.zeros(7), "must hold .*arm_7_joint, fingers as an episode starts, got 7"),
        (np.zeros(9), "arm_7_joint, fingers as an episode starts, got 9"),
        ([0.206, -0.036, -1.35, 1.81, 0.52, 0.0, 0.95, 0.078], "within the limits"),
    ],
)
def test_the_server_reads_the_fingers_as_an_episode_starts(url, state, words):
    from websockets.sync.client import connect

    from knowarm.deploy.messages import pack, unpack

    with connect(url, compression=None) as link:
        about = unpack(link.recv())
        assert about["joints"]["gripper"]["closed"] == pytest.approx(0.039)
        assert "arm_7_joint, fingers" in about["observation"]["observation/state"]
        home = np.array(about["joints"]["home"])
        image = {"observation/image": IMAGE, "prompt": None, "reset": True}
        link.send(pack(image | {"observation/state": home}))
        assert unpack(link.recv())["actions"].shape == (1, 8)
        link.send(pack(image | {"observation/state": np.array(state)}))
        answer = link.recv()
        assert isinstance(answer, str)
        assert re.search(words, answer)


def mapped(tmp_path, *lines):
    """Write a map of the arm's joints as the model has them, and further lines."""
    arm = [f"{name} = {{}}" for name in ROBOTS["tiago"].joints]
    file = tmp_path / "map.toml"
    file.write_text("\n".join(["[joint_map]", *arm, *lines]))
    return file


@pytest.mark.parametrize(
    ("fields", "unit", "values"),
    [
        ("", "m", [0, 0.0195, 0.039, 0.039]),
        ("sign = -1, offset = 0.039", "m", [0.039, 0.0195, 0, 0]),
        ("sign = -1, scale = 2, offset = 0.078", "m", [0.078, 0.039, 0, 0]),
        ('unit = "range_0_1"', "range_0_1", [0, 0.5, 1, 1]),
        (
            'unit = "range_0_100", sign = -1, offset = 100, name = "gripper.pos"',
            "range_0_100",
            [100, 50, 0, 0],
        ),
        ('unit = "range_m100_100"', "range_m100_100", [-100, 0, 100, 100]),
        ('unit = "range_0_1", range = [0, 0.0195]', "range_0_1", [0, 1, 1, 1]),
        (
            'unit = "range_0_1", range = [0, 0.078]',
            "range_0_1",
            [0, 0.25, 0.5, 59 / 78],
        ),
    ],
)
def test_a_real_gripper_is_sent_open_to_closed(trained, tmp_path, fields, unit, values):
    """From open over half to closed; the policy's targets end beyond, the gripper's do not."""
    file = mapped(tmp_path, f"fingers = {{{fields}}}")
    contract = deployment(trained, file).contract
    (*_, entry) = contract["joints"]["real"]
    assert (entry["joint"], entry["unit"]) == ("fingers", unit)
    joint_map = JointMap(json.loads(json.dumps(contract["joints"])))
    targets = np.zeros((4, 8))
    targets[:, -1] = [0, 0.0195, 0.039, 0.059]
    sent = joint_map.to_real(targets)
    np.testing.assert_allclose(sent[:, -1], values, atol=1e-9)
    back = joint_map.from_real(sent[:2])
    reachable = 1 if "0.0195]" in fields else 2
    np.testing.assert_allclose(back[:reachable], targets[:reachable], atol=1e-9)


def test_without_a_map_targets_go_beyond_closed(runner):
    targets = np.full((1, 8), 0.059)
    np.testing.assert_array_equal(runner.joint_map.to_real(targets), targets)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('fingers = {unit = "deg"}', "deg is of joints that turn"),
        ('fingers = {name = "arm_1_joint"}', "a name twice"),
        ("jaw = {}", "joint_map names 'jaw'"),
    ],
)
def test_a_map_that_does_not_fit_the_gripper_is_refused(trained, tmp_path, line, words):
    with pytest.raises(UserError, match=words):
        deployment(trained, mapped(tmp_path, line))


def test_a_map_that_holds_the_jaw_of_a_gripper_that_moves_is_refused():
    """Else the jaw is told to stay open while the policy closes fingers that no arm has."""
    robot = ROBOTS["irb120"]
    fewer = {"joints": robot.joints[:5], "home": robot.home[:5], "areas": {}}
    joint_map = dict.fromkeys(robot.joints, RealJoint())
    scene = scene_with(joint_map, **fewer)
    assert len(real_joints(scene)) == 6
    scene.fingers = Fingers(closed_m=0.03, force_n=40.0)
    with pytest.raises(UserError, match="holds joint_6 still, and this task moves"):
        real_joints(scene)
    scene = scene_with(joint_map | {"fingers": RealJoint(name="jaw")}, **fewer)
    assert real_joints(scene)[-1]["name"] == "jaw"


@pytest.mark.parametrize(
    ("fields", "value"),
    [
        ("sign = -1, offset = 0.039", 0.039),
        ('unit = "range_0_100", sign = -1, offset = 100', 100.0),
        ('unit = "range_0_1"', 0.0),
        ('unit = "range_0_1", range = [0.001, 0.041]', -0.025),
    ],
)
def test_a_policy_of_the_arm_alone_sends_a_gripper_of_the_map_open(
    tmp_path, fields, value
):
    arm = load_agent(ROOT / "zoo" / "tiago-full-fast")
    file = mapped(tmp_path, f"fingers = {{{fields}}}")
    runner = deployment(arm, file).runner()
    assert runner.joint_map.names[-1] == "fingers"
    assert runner.joint_map.to_real(np.zeros((1, 7)))[0, -1] == pytest.approx(value)


def features(folder):
    return json.loads((folder / "meta/info.json").read_text())["features"]


def test_a_dataset_has_the_gripper_as_its_own_entry(tmp_path):
    """In metres, and with a map as LeRobot counts grippers: 100 is open."""
    fields = 'name = "gripper.pos", unit = "range_0_100", sign = -1, offset = 100'
    file = mapped(tmp_path, f"fingers = {{{fields}}}")
    options = {"plain": [], "real": ["--joint-map", str(file)]}
    frames = {}
    for name, more in options.items():
        folder = tmp_path / name
        command = ["record", str(RUN), "--episodes", "1", "--to", str(folder), *more]
        assert main(command) == 0
        frames[name] = pq.read_table(folder / "data").to_pylist()
    for column in ("observation.state", "action"):
        plain = features(tmp_path / "plain")[column]
        real = features(tmp_path / "real")[column]
        assert (plain["names"][-1], plain["units"][-1]) == ("fingers", "m")
        assert (real["names"][-1], real["units"][-1]) == ("gripper.pos", "range_0_100")
        assert plain["shape"] == real["shape"] == [8]
        metres = np.array([frame[column][-1] for frame in frames["plain"]])
        sent = np.array([frame[column][-1] for frame in frames["real"]])
        np.testing.assert_allclose(
            sent, (100 - metres / 0.00039).clip(0, 100), atol=1e-3
        )
        assert sent[0] == 100
        assert sent[-1] < 60, "it closed"
    assert metres.max() > 0.039, "a target beyond closed"
    assert features(tmp_path / "plain")["action.levels"]["names"][-1] == "fingers"


class Hand:
    """A driver of one joint and fingers, whose policy closes at level 1; 0.02 m are held."""

    def __init__(self, **safety):
        self.levels = [[1, 1]]
        joints = {
            "names": ["elbow", "fingers"],
            "lower": [-1.0, 0.0],
            "upper": [1.0, 0.06],
            "home": [0.0, 0.0],
            "mpi": 0.03,
            "increments": [0.0, 0.03, -0.03],
            "gripper": {"joint": "fingers", "closed": 0.04},
        }

        def policy(inputs):
            return np.array(self.levels), None, None, inputs["h"], inputs["c"]

        contract = CONTRACT | {"joints": joints}
        self.runner = Runner(contract, np.zeros((2, 3), np.float32), policy)
        safety = {"confirm_steps": 0} | safety
        place = lambda angles: np.zeros(3)  # noqa: E731
        row = "usedFor drinking"
        self.driver = Driver(self.runner, place, Safety(**safety), row)
        self.now = 100.0
        self.driver.clock = lambda: self.now
        self.sent = np.zeros(2)

    def tick(self):
        """Let a period pass: the elbow follows, and the fingers until they touch."""
        self.now += 0.1
        self.driver.see(IMAGES[round(10 * self.now) % 64], self.now)
        reading = [self.sent[0], min(self.sent[1], 0.02)]
        self.driver.feel(["elbow", "fingers"], reading, self.now)
        targets = self.driver.tick(self.now)
        if targets is not None:
            self.sent = targets
        return targets


IMAGES = np.random.default_rng(0).integers(0, 256, (64, 4, 4, 3), np.uint8)


def test_fingers_press_what_they_hold_and_the_arm_goes_on():
    hand = Hand(following_steps=1.2)
    fingers = [hand.tick()[1] for _ in range(4)]
    np.testing.assert_allclose(fingers, [0.03, 0.06, 0.06, 0.06])
    np.testing.assert_allclose(hand.sent[0], 0.12)


def test_fingers_close_by_the_largest_step_of_the_safety_rules():
    hand = Hand(gripper_step_m=0.008)
    hand.levels = [[1, 1]]
    targets = [hand.tick(), hand.tick()]
    hand.levels = [[1, 0]]  # the policy has closed them, and they follow
    targets += [hand.tick() for _ in range(7)]
    targets = np.array(targets)
    np.testing.assert_allclose(targets[:, 0], 0.03 * np.arange(1, 10))
    np.testing.assert_allclose(targets[:, 1], (0.008 * np.arange(1, 10)).clip(max=0.06))
    hand.levels = [[0, 2]]
    np.testing.assert_allclose(hand.tick(), [0.27, 0.052])


def test_fingers_faster_than_the_contract_says_end_the_episode():
    hand = Hand(gripper_step_m=0.008)
    hand.levels = [[0, 0]]
    assert hand.tick() is not None
    act = lambda _: setattr(hand.runner, "targets", np.array([[0.0, 0.06]]))  # noqa: E731
    hand.runner.act = act
    assert hand.tick() is None
    assert "fingers: faster than 0.3 / s" in hand.driver.end


@pytest.mark.parametrize("how", ["stop", "hold"])
def test_a_stop_or_hold_keeps_what_is_held(how):
    """Nothing is sent, so that the gripper keeps its last target; a hold goes on from there."""
    hand = Hand()
    hand.tick()
    held = hand.tick()
    assert held[1] == 0.06
    hand.levels = [[0, 2]]
    if how == "stop":
        hand.driver.stop("stopped by /knowarm/stop")
        assert [hand.tick() for _ in range(5)] == [None] * 5
    else:
        hand.now += 0.1
        assert hand.driver.tick(hand.now, "no controller") is None
        hand.levels = [[1, 0]]
        np.testing.assert_allclose(hand.tick(), [0.09, 0.06])
    np.testing.assert_allclose(hand.runner.targets[0, 1], 0.06)


def test_a_dry_run_prints_the_gripper_and_sends_nothing():
    hand = Hand(dry_run=True)
    assert hand.tick() is None
    assert hand.driver.status.endswith(
        "elbow +0.030, fingers +0.030, gripper 75% closed"
    )
    hand.sent = np.array([0.0, 0.02])
    assert hand.tick() is None
    assert hand.driver.status.endswith("fingers +0.030, gripper 100% closed")


def test_steps_of_a_gripper_need_one(trained):
    arm = deployment(load_agent(ROOT / "zoo" / "tiago-full-fast")).runner()
    with pytest.raises(UserError, match="moves no gripper: leave gripper_step_m out"):
        Driver(arm, np.zeros_like, Safety(gripper_step_m=0.01))
    with pytest.raises(UserError, match="gripper_step_m"):
        Safety(gripper_step_m=0.0)


def lifted_by_the_driver(trained, episode, **safety):
    """Play an episode in the simulator by a driver; return success and the fingers' targets."""
    parts = deployment(trained)
    place = partial(tcp_position, parts.scene)
    driver = Driver(parts.runner(), place, Safety(confirm_steps=0, **safety))
    now = 100.0
    driver.clock = lambda: now
    env = ArmVectorEnv(trained.config.env, 1, autoreset_mode=AutoresetMode.DISABLED)
    images, _ = env.reset(options={"episodes": episode})
    sent = [env.joint_positions[0]]
    ended = False
    while not ended:
        now += 0.1
        driver.see(images[0], now)
        driver.feel(driver.joint_names, env.joint_positions[0], now)
        targets = driver.tick(now)
        sent.append(sent[-1] if targets is None else targets)
        env.running.joint_targets[0] = sent[-1]
        images, _, terminated, truncated, infos = env.step(np.zeros((1, 8), int))
        ended = terminated[0] or truncated[0]
    return infos["is_success"][0], np.array(sent)[:, -1]


@pytest.mark.slow
@pytest.mark.parametrize("step_m", [None, 0.012])
def test_a_driven_gripper_lifts_as_the_policy_does(trained, episodes, played, step_m):
    """Slowly, too: it goes on closing in the steps after that in which the policy closes it."""
    solved = []
    for number in range(6):
        episode = episodes[number : number + 1]
        success, fingers = lifted_by_the_driver(trained, episode, gripper_step_m=step_m)
        assert abs(np.diff(fingers)).max() <= (step_m or 0.042) + 1e-9
        assert fingers.max() > 0.039
        solved.append(success)
    np.testing.assert_array_equal(solved, played.success[:6])
