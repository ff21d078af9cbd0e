"""ROS 2 node of a `Driver`: images and joint states in, trajectories or positions out."""

import sys
import threading
import time
from typing import Any

from knowarm.deploy.driver import Driver, Topics, decoded, decompressed
from knowarm.deploy.watch import Publisher, unheard
from knowarm.errors import UserError, packages_of
from knowarm.reading import one_line
from knowarm.world.robots.robot import FINGERS_JOINT

with packages_of("ros", "Driving a robot"):
    import rclpy
    from builtin_interfaces.msg import Duration
    from rclpy.event_handler import SubscriptionEventCallbacks
    from rclpy.executors import SingleThreadedExecutor
    from rclpy.node import Node
    from rclpy.parameter import Parameter
    from rclpy.qos import (
        QoSCompatibility,
        QoSProfile,
        qos_check_compatible,
        qos_profile_sensor_data,
    )
    from rclpy.signals import SignalHandlerOptions
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import CompressedImage, Image, JointState
    from std_msgs.msg import Empty, Float64MultiArray
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

DISCOVERY_S = 1.0
"""Time before the first control period, in which ROS discovers other programs [s]."""


class DriverNode(Node):
    """Feeds a driver with messages, and publishes what it returns in each control period."""

    def __init__(self, driver: Driver, topics: Topics) -> None:
        clock = Parameter("use_sim_time", value=topics.use_clock)
        super().__init__("knowarm", parameter_overrides=[clock])
        self.driver = driver
        self._shown = ""
        self._outs = []
        self._sends_positions = bool(topics.positions)
        latest = qos_profile_sensor_data
        images = CompressedImage if topics.compressed else Image
        self.create_subscription(images, topics.image, self._see, latest)
        self.create_subscription(JointState, topics.joint_states, self._feel, latest)
        # Message type and most publishers of every input; joints are counted one by one.
        self._inputs = {topics.image: (images, 1), topics.joint_states: (JointState, 0)}
        if topics.use_clock:
            self._inputs["/clock"] = (Clock, 1)
        self._stop = topics.stop
        self._stoppers = 0
        # A reliable subscription receives nothing from a best-effort publisher; a best-effort one
        # may lose a message on a bad network.
        quiet = SubscriptionEventCallbacks(incompatible_qos=lambda _: None)
        for qos in (QoSProfile(depth=1), latest):
            self.create_subscription(
                Empty,
                topics.stop,
                lambda _: driver.stop(f"stopped by {topics.stop}"),
                qos,
                event_callbacks=quiet,
            )
        if not driver.safety.dry_run:
            kind = Float64MultiArray if self._sends_positions else JointTrajectory
            for topic, joints in _outputs(driver, topics).items():
                out = self.create_publisher(kind, topic, 1)
                self._outs.append((out, joints))
        if topics.use_clock:
            driver.clock = self._seconds
        self._from = time.monotonic() + DISCOVERY_S
        self.create_timer(driver.period_s, self._tick)

    def show(self) -> None:
        """Print the driver's status where it has changed."""
        if self.driver.status != self._shown:
            self._shown = self.driver.status
            print(self._shown, flush=True)

    def _seconds(self) -> float:
        """Return the time by the clock of the stamps [s]."""
        return float(self.get_clock().now().nanoseconds * 1e-9)

    def _see(self, image: Any) -> None:
        data = bytes(image.data)
        if isinstance(image, CompressedImage):
            pixels = decompressed(data)
        else:
            pixels = decoded(
                image.encoding, image.height, image.width, image.step, data
            )
        self.driver.see(pixels, _stamp(image))

    def _feel(self, state: Any, info: Any) -> None:
        source = str(info["publisher_gid"])
        self.driver.feel(state.name, state.position, _stamp(state), source)

    def _unheard(self, topic: str, kind: Any) -> tuple[int, str]:
        """Count the publishers of a topic; say which of them cannot be heard, if there is one."""
        publishers = []
        for info in self.get_publishers_info_by_topic(topic):
            fit, _ = qos_check_compatible(info.qos_profile, qos_profile_sensor_data)
            connects = fit != QoSCompatibility.ERROR
            publishers.append(Publisher(info.topic_type, connects))
        package = kind.__module__.split(".")[0]
        problem = unheard(topic, f"{package}/msg/{kind.__name__}", publishers)
        return len(publishers), problem

    def _check_stop(self) -> None:
        """End the episode if a program could stop it and would not be heard."""
        stoppers, problem = self._unheard(self._stop, Empty)
        if self.count_clients(self._stop):
            problem = f"a program calls {self._stop} as a service, and it is a topic"
        if stoppers < self._stoppers:
            problem = f"a program that could publish to {self._stop} has left"
        self._stoppers = stoppers
        if problem:
            self.driver.stop(f"stopped: {problem}")

    def _obstacle(self) -> str:
        """Say what is wrong with the programs that publish inputs or receive targets."""
        for topic, (kind, most) in self._inputs.items():
            publishers, problem = self._unheard(topic, kind)
            if problem:
                return problem
            if 0 < most < publishers:
                return f"{publishers} programs publish to {topic}"
        for out, _ in self._outs:
            if self.count_publishers(out.topic_name) > 1:
                return f"another program publishes to {out.topic_name}"
            # Of this type and quality of service
            if not out.get_subscription_count():
                return f"no controller at {out.topic_name}"
        return ""

    def _tick(self) -> None:
        self._check_stop()
        if time.monotonic() < self._from or not self._seconds():  # no /clock yet
            return
        targets = self.driver.tick(self._seconds(), self._obstacle())
        if targets is not None:
            for out, joints in self._outs:
                positions = targets[joints].tolist()
                out.publish(self._command(joints, positions))
        self.show()

    def _command(self, joints: list[int], targets: list[float]) -> Any:
        """Return the message for targets, which a trajectory reaches after a control period."""
        if self._sends_positions:
            return Float64MultiArray(data=targets)
        names = self.driver.joint_names
        point = JointTrajectoryPoint(positions=targets)
        whole, part = divmod(round(self.driver.period_s * 1e9), 10**9)
        point.time_from_start = Duration(sec=whole, nanosec=part)
        return JointTrajectory(
            joint_names=[names[joint] for joint in joints],
            points=[point],
        )


def _outputs(driver: Driver, topics: Topics) -> dict[str, list[int]]:
    """Return the topics of controllers, with the indices of the joints of each.

    Raises:
        UserError: there is a topic for a gripper, and no gripper, or the arm has the same topic.
    """
    arm = topics.positions or topics.trajectory
    gripper = topics.gripper or arm
    outputs: dict[str, list[int]] = {arm: [], gripper: []}
    for number, joint in enumerate(driver.model_joints):
        topic = arm
        if joint == FINGERS_JOINT:
            topic = gripper
        outputs[topic].append(number)
    if topics.gripper == arm or not outputs[gripper]:
        raise UserError(
            f"The gripper needs a topic other than {arm}, and a policy or joint map with fingers: "
            "leave --topic.gripper out, and all joints go to one controller."
        )
    return outputs


def _stamp(message: Any) -> float:
    """Return when a message was measured [s]; 0 if it does not say."""
    return float(message.header.stamp.sec + message.header.stamp.nanosec * 1e-9)


def drive(driver: Driver, topics: Topics) -> None:
    """Drive the robot until the episode ends; a line at the terminal confirms a step or stops.

    Raises:
        UserError: the episode was stopped before its last step.
    """
    threading.Thread(target=_listen, args=[driver], daemon=True).start()
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = DriverNode(driver, topics)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while not driver.end:
            executor.spin_once(timeout_sec=driver.period_s)
        node.show()
    finally:
        rclpy.shutdown()
    if not driver.completed:
        raise UserError(f"The episode was {driver.end}.")


def _listen(driver: Driver) -> None:
    try:
        for line in sys.stdin.buffer if sys.stdin else ():  # bytes: any key stops
            if line.strip() or driver.steps >= driver.safety.confirm_steps:
                driver.stop("stopped at the terminal")
            driver.confirm()
        if driver.steps < driver.safety.confirm_steps and not driver.safety.dry_run:
            driver.stop("stopped: nobody is at the terminal to confirm the first steps")
    except Exception as error:
        driver.stop(f"stopped: the terminal cannot be read: {one_line(error)}")
