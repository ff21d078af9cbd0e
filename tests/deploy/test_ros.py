"""Real ROS 2 nodes on the loopback: a simulated robot is driven; what must not move does not."""

import io
import itertools
import os
import subprocess
import sys
import threading
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")

import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import CompressedImage, Image, JointState
from std_msgs.msg import Bool, Empty, Header, String
from trajectory_msgs.msg import JointTrajectory

from benchmarks.deployment import by_ros
from knowarm.deploy import ros
from knowarm.deploy.contract import deployment, tcp_position
from knowarm.deploy.driver import Driver, Safety, Topics
from knowarm.deploy.ros import drive
from knowarm.errors import UserError
from knowarm.experiment.load import load_agent
from knowarm.world.agents.play import play
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from tests.source_tree import ROOT

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
RUN = ROOT / "zoo" / "tiago-full-fast"
TOPICS = Topics()
NUMBERS = itertools.count(os.getpid())


@pytest.fixture(autouse=True)
def domain(monkeypatch):
    """A domain of ROS for each test: others are other robots, some of which are about to end."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(1 + next(NUMBERS) % 100))


@pytest.fixture(autouse=True)
def terminal(monkeypatch):
    """A terminal at which nobody types; the end of its input stops nothing without confirmation."""
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO()))


@pytest.fixture(scope="module")
def trained():
    return load_agent(RUN)


@pytest.fixture(scope="module")
def parts(trained):
    return deployment(trained)


def test_the_simulated_robot_is_driven_as_in_process(trained, parts):
    episodes = evaluation_episodes(trained.config.env, 3, 0)
    solved, ends = by_ros(trained.config.env, parts, episodes, 0.0)
    ours = play(trained.agent, ArmVectorEnv(trained.config.env, 1), episodes)
    np.testing.assert_array_equal(solved, ours.success)
    assert solved.any(), ends


@pytest.mark.parametrize(
    "topics",
    [{"compressed": True}, {"positions": "/forward_position_controller/commands"}],
    ids=str,
)
def test_a_robot_in_degrees_is_driven_as_one_in_radians(
    trained, parts, topics, tmp_path
):
    file, names = tmp_path / "map.toml", parts.contract["joints"]["names"]
    lines = [
        f'{n} = {{name = "{n}.pos", sign = -1, offset = 7.5, unit = "deg"}}'
        for n in names
    ]
    file.write_text("\n".join(["[joint_map]", *reversed(lines)]))
    episodes = evaluation_episodes(trained.config.env, 3, 0)
    mapped = deployment(trained, file)
    solved, ends = by_ros(trained.config.env, mapped, episodes, 0.0, file, **topics)
    ours = play(trained.agent, ArmVectorEnv(trained.config.env, 1), episodes)
    np.testing.assert_array_equal(solved, ours.success)
    assert solved.any(), ends


class Cell:
    """Camera, joints and controller of a robot that stands still."""

    def __init__(
        self,
        parts,
        image=None,
        state=None,
        controllers=1,
        stop_qos=1,
        topics=TOPICS,
        grippers=1,
    ):
        self.topics, self.gripped, self._grippers = topics, [], grippers
        self.parts, self.image, self.state = parts, image or {}, state or {}
        self.received, self.driver, self._over = [], None, False
        self._controllers, self._stop_qos = controllers, stop_qos
        self.then = lambda: None
        self._others = {}

    def publisher(self, kind, topic, qos=1):
        """Return a second publisher of a topic, made when it is first used."""
        return self._once(topic, lambda: self.other.create_publisher(kind, topic, qos))

    def call(self, kind, name):
        """Call a service."""
        self._once(name, lambda: self.other.create_client(kind, name))

    def listen(self, kind, topic):
        """Subscribe to a topic with a type of message."""
        take = self.received.append
        self._once(topic, lambda: self.other.create_subscription(kind, topic, take, 1))

    def _once(self, name, make):
        if name not in self._others:
            self._others[name] = make()
        return self._others[name]

    def drive(self, **safety):
        """Run `drive` beside the cell; return the driver."""
        options = {
            "confirm_steps": 0,
            "patience_s": 1.0,
            "wait_s": 1.0,
            "max_steps": 5,
        } | safety
        gripper = lambda joints: tcp_position(self.parts.scene, joints)  # noqa: E731
        row = self.parts.contract["knowledge"]["rows"][0]
        self.driver = Driver(self.parts.runner(), gripper, Safety(**options), row)
        thread = threading.Thread(target=self._publish)
        thread.start()
        try:
            drive(self.driver, self.topics)
        finally:
            self._over = True
            thread.join()
        return self.driver

    def _publish(self):
        context = rclpy.Context()
        rclpy.init(context=context)
        node = rclpy.create_node("cell", context=context)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        images = node.create_publisher(Image, TOPICS.image, 1)
        states = node.create_publisher(JointState, TOPICS.joint_states, 1)
        self.stop = node.create_publisher(Empty, TOPICS.stop, self._stop_qos)
        for _ in range(self._controllers):
            node.create_subscription(
                JointTrajectory, TOPICS.trajectory, self.received.append, 1
            )
        if self.topics.gripper and self._grippers:
            node.create_subscription(
                JointTrajectory, self.topics.gripper, self.gripped.append, 1
            )
        self.node = node
        context_of_others = rclpy.Context()
        rclpy.init(context=context_of_others)
        self.other = rclpy.create_node("other", context=context_of_others)
        joints = self.parts.contract["joints"]
        while not self._over:
            image = {
                "encoding": "rgb8",
                "height": 64,
                "width": 64,
                "step": 192,
            } | self.image
            size = image["height"] * image["step"]
            stamp = {"stamp": node.get_clock().now().to_msg()}
            data = (np.arange(size) % 251).astype(np.uint8).tobytes()
            images.publish(Image(header=Header(**stamp), data=data, **image))
            state = {
                "name": list(joints["names"]),
                "position": list(joints["home"]),
            } | self.state
            states.publish(JointState(header=Header(**stamp), **state))
            executor.spin_once(timeout_sec=0.02)
            self.then()
        for one in (node, self.other):
            one.destroy_node()
            one.context.shutdown()


def test_a_robot_that_stands_still_receives_trajectories(parts):
    cell = Cell(parts)
    assert cell.drive(following_steps=100).completed
    message = cell.received[0]
    assert message.joint_names == list(parts.contract["joints"]["names"])
    assert message.points[0].time_from_start.nanosec == 100_000_000
    change = np.array(message.points[0].positions) - parts.contract["joints"]["home"]
    assert 0 < np.abs(change).max() <= parts.contract["joints"]["mpi"] * 1.001


@pytest.fixture(scope="module")
def lifting():
    return deployment(load_agent(ROOT / "zoo" / "tiago-lift-full-distil"))


def test_a_gripper_is_one_more_joint_of_the_trajectory(lifting):
    cell = Cell(lifting)
    assert cell.drive(following_steps=100).completed
    message = cell.received[0]
    assert message.joint_names == list(lifting.contract["joints"]["names"])
    assert message.joint_names[-1] == "fingers"
    assert 0 <= message.points[0].positions[-1] <= 0.042


GRIPPER = "/gripper_controller/joint_trajectory"


def test_a_gripper_has_a_controller_of_its_own(trained, tmp_path):
    """As its joint map counts it: here in metres from closed."""
    file, arm = tmp_path / "map.toml", [f"arm_{i}_joint" for i in range(1, 8)]
    lines = [f"{name} = {{}}" for name in arm]
    gripper = 'fingers = {name = "gripper_joint", sign = -1, offset = 0.039}'
    file.write_text("\n".join(["[joint_map]", gripper, *lines]))
    parts = deployment(load_agent(ROOT / "zoo" / "tiago-lift-full-distil"), file)
    joints = parts.contract["joints"]
    state = {"name": [*arm, "gripper_joint"], "position": [*joints["home"][:7], 0.039]}
    cell = Cell(parts, state=state, topics=Topics(gripper=GRIPPER))
    assert cell.drive(following_steps=100).completed
    assert cell.received[0].joint_names == arm
    assert cell.gripped[0].joint_names == ["gripper_joint"]
    assert len(cell.gripped) >= 2
    assert len(cell.received) >= 2  # the last ones may arrive after the end
    assert 0 <= cell.gripped[0].points[0].positions[0] <= 0.039


def test_no_controller_of_the_gripper_moves_nothing(lifting):
    cell = Cell(lifting, topics=Topics(gripper=GRIPPER), grippers=0)
    with pytest.raises(UserError, match=f"no controller at {GRIPPER}"):
        cell.drive()
    assert not cell.received


@pytest.mark.parametrize("topic", [GRIPPER, TOPICS.trajectory])
def test_a_topic_without_a_gripper_is_refused(parts, lifting, topic):
    mine = parts if topic == GRIPPER else lifting
    cell = Cell(mine, topics=Topics(gripper=topic))
    with pytest.raises(UserError, match=r"leave --topic\.gripper out"):
        cell.drive()


@pytest.mark.parametrize(
    ("cell", "words"),
    [
        ({"image": {"height": 32}}, "image is (32, 64, 3)"),
        ({"image": {"encoding": "mono8"}}, "mono8"),
        ({"state": {"name": ["torso_lift_joint"], "position": [0.2]}}, "not yet seen"),
        (
            {"state": {"name": ["arm_1_joint"], "position": [0.2]}},
            "lack a number for arm_2_joint",
        ),
        ({"state": {"position": [float("nan")] * 7}}, "lack a number"),
        ({"controllers": 0}, "no controller"),
    ],
)
def test_wrong_input_moves_nothing(parts, cell, words):
    cell = Cell(parts, **cell)
    with pytest.raises(UserError, match="stopped after 1 s") as error:
        cell.drive()
    assert words in str(error.value)
    assert "\n" not in str(error.value)
    assert not cell.received


def test_a_second_program_on_the_topic_moves_nothing(parts):
    cell = Cell(parts)
    other = rclpy.Context()
    rclpy.init(context=other)
    node = rclpy.create_node("other", context=other)
    node.create_publisher(JointTrajectory, TOPICS.trajectory, 1)
    try:
        with pytest.raises(UserError, match="another program"):
            cell.drive(max_steps=500, following_steps=1000)
    finally:
        node.destroy_node()
        other.shutdown()
    assert len(cell.received) < 50, "only until the other one is discovered"


@pytest.mark.parametrize(
    "qos", [1, qos_profile_sensor_data], ids=["reliable", "best effort"]
)
def test_the_stop_topic_ends_the_episode(parts, qos):
    cell = Cell(parts, stop_qos=qos)
    cell.then = lambda: cell.received and cell.stop.publish(Empty())
    with pytest.raises(UserError, match="stopped by /knowarm/stop"):
        cell.drive(max_steps=500, following_steps=1000)
    assert len(cell.received) < 100


@pytest.mark.parametrize("kind", [Bool, String, Header], ids=lambda kind: kind.__name__)
@pytest.mark.parametrize(
    "qos",
    [
        1,
        qos_profile_sensor_data,
        QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL),
    ],
    ids=["reliable", "best effort", "latched"],
)
def test_a_stop_of_another_type_ends_the_episode(parts, kind, qos):
    cell = Cell(parts)
    cell.then = lambda: cell.received and cell.publisher(kind, TOPICS.stop, qos)
    with pytest.raises(
        UserError, match=f"publishes .*/msg/{kind.__name__} to /knowarm/stop"
    ):
        cell.drive(max_steps=500, following_steps=1000)
    assert len(cell.received) < 40


def test_a_stop_of_another_type_before_the_start_moves_nothing(parts):
    cell = Cell(parts)
    cell.then = lambda: cell.publisher(Bool, TOPICS.stop)
    with pytest.raises(UserError, match="publishes std_msgs/msg/Bool"):
        cell.drive(max_steps=500, following_steps=1000)
    assert not cell.received


def test_a_stop_that_is_called_as_a_service_ends_the_episode(parts):
    cell = Cell(parts)
    cell.then = lambda: cell.received and cell.call(GetParameters, TOPICS.stop)
    with pytest.raises(UserError, match="calls /knowarm/stop as a service"):
        cell.drive(max_steps=500, following_steps=1000)
    assert len(cell.received) < 40


def test_the_episode_ends_with_the_program_that_could_stop_it(parts):
    cell = Cell(parts)

    def leave():
        cell.stop.destroy()
        return True

    cell.then = lambda: cell.received and cell._once("gone", leave)
    with pytest.raises(UserError, match="could publish to /knowarm/stop has left"):
        cell.drive(max_steps=500, following_steps=1000)


@pytest.mark.parametrize(
    ("kind", "topic", "words"),
    [
        (Image, TOPICS.image, "2 programs publish to /camera/image_raw"),
        (CompressedImage, TOPICS.image, "publishes sensor_msgs/msg/CompressedImage to"),
        (String, TOPICS.joint_states, "publishes std_msgs/msg/String to /joint_states"),
    ],
    ids=["two cameras", "image of another type", "joints of another type"],
)
def test_a_second_source_of_an_input_moves_nothing(parts, kind, topic, words):
    cell = Cell(parts)
    cell.then = lambda: cell.publisher(kind, topic)
    with pytest.raises(UserError, match=words):
        cell.drive()
    assert not cell.received


@pytest.mark.parametrize("apart", [0.0, 0.02, 0.08])
def test_two_programs_with_the_same_joints_move_nothing(parts, apart):
    cell, joints = Cell(parts), parts.contract["joints"]

    def publish():
        stamp = cell.node.get_clock().now().to_msg()
        angles = (np.array(joints["home"]) + apart).tolist()
        state = JointState(name=list(joints["names"]), position=angles)
        state.header.stamp = stamp
        cell.publisher(JointState, TOPICS.joint_states).publish(state)

    cell.then = publish
    with pytest.raises(UserError, match=r"come from 2 programs|joint angles jump"):
        cell.drive(max_steps=500, following_steps=1000)
    assert len(cell.received) < 50, "only until the other one is discovered"


def test_a_controller_of_another_type_moves_nothing(parts):
    cell = Cell(parts, controllers=0)
    cell.then = lambda: cell.listen(String, TOPICS.trajectory)
    with pytest.raises(UserError, match="no controller"):
        cell.drive()


def test_a_dry_run_sends_nothing(parts):
    cell = Cell(parts)
    assert cell.drive(dry_run=True).completed
    assert not cell.received


class Broken(io.BytesIO):
    """A terminal that has gone."""

    def __next__(self):
        raise OSError(5, "Input/output error")


@pytest.mark.parametrize(
    ("terminal", "step", "reason"),
    [
        (io.BytesIO(b"\n"), 1, "nobody is at the terminal"),
        (io.BytesIO(b"\n"), 5, "stopped at the terminal"),
        (io.BytesIO(b"x\n"), 1, "stopped at the terminal"),
        (io.BytesIO(b"\xe9\n"), 1, "stopped at the terminal"),
        (Broken(), 5, "the terminal cannot be read: "),
        (None, 1, "nobody is at the terminal"),
    ],
)
def test_every_line_but_a_confirmation_stops(terminal, step, reason, monkeypatch):
    said = []
    driver = SimpleNamespace(
        steps=step,
        safety=Safety(confirm_steps=5),
        stop=said.append,
        confirm=lambda: None,
    )
    monkeypatch.setattr("sys.stdin", terminal and io.TextIOWrapper(terminal, "utf-8"))
    ros._listen(driver)
    assert reason in said[0]


def test_nobody_confirms_the_first_steps():
    command = [sys.executable, "-m", "knowarm", "ros", str(RUN), "--wait-s", "30"]
    done = subprocess.run(
        command,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        env=os.environ,
    )
    assert done.returncode == 2
    assert "nobody is at the terminal" in done.stderr
    assert done.stderr.count("\n") == 1
