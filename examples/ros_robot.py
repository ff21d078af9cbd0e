"""Simulated robot behind ROS 2 topics: camera, joint states and a joint trajectory controller.

pip install 'knowarm[ros]'
python examples/ros_robot.py zoo/irb120-full-fast --episodes 1 &
knowarm ros zoo/irb120-full-fast

A policy whose contract has several rows of knowledge, such as one of the choose task, also takes
--knowledge "the knowledge that this program prints"; one whose contract has one row takes none.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage, Image, JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

from knowarm.deploy.driver import Topics
from knowarm.deploy.joint_map import real_joints
from knowarm.deploy.runner import JointMap
from knowarm.errors import UserError
from knowarm.experiment.load import load_agent
from knowarm.pictures import encode
from knowarm.world.backend import MujocoSimulator
from knowarm.world.config import EnvConfig, facets_of, scene_of
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.running import RunningEpisodes
from knowarm.world.envs.vector_env import draw_images
from knowarm.world.render.renderer import make_renderer
from knowarm.world.scene.compose import CONTROL_PERIOD_S, SUBSTEPS
from knowarm.world.scene.scene import Scene
from knowarm.world.tasks.sampling import Episodes

TICK_S = CONTROL_PERIOD_S / SUBSTEPS
"""Period of camera and joint states [s]."""


class Arm(MujocoSimulator):
    """Arm that follows the commands of a controller; ``on_tick`` is called before every move."""

    def __init__(self, scene: Scene, on_tick: Callable[[], None]) -> None:
        super().__init__(scene, 1, 1)
        self.substeps = 1
        self.command: np.ndarray | None = None
        self._on_tick = on_tick

    def step(self, joint_targets: np.ndarray, ids: np.ndarray | None = None) -> None:
        for _ in range(SUBSTEPS):
            self._on_tick()
            command = joint_targets if self.command is None else self.command[None]
            super().step(command, ids)


class RobotNode(Node):
    """Robot and camera of an environment config; ``wait`` lets a tick pass.

    Args:
        config: the environment.
        topics: where it publishes and listens.
        delay_s: age of images and joint states when they are published [s].
        joint_map: TOML file with the names and units that it speaks; None: as its description says.
    """

    def __init__(
        self,
        config: EnvConfig,
        topics: Topics,
        wait: Callable[[], None],
        delay_s: float = 0.0,
        joint_map: Path | None = None,
    ) -> None:
        super().__init__("robot")
        scene = scene_of(config)
        if scene.fingers is not None:
            raise UserError(
                "This robot's fingers do not move: take a policy that reaches."
            )
        self.wait, self.commands, self.late = wait, 0, round(delay_s / TICK_S)
        self.arm = Arm(scene, self._tick)
        self.running = RunningEpisodes(config, self.arm)
        names = scene.robot.joints
        self.joint_map = JointMap(
            {"names": names, "real": real_joints(scene, joint_map)}
        )
        self._renderer = make_renderer(scene, config, config.image_size, 1)
        kind: Any = CompressedImage if topics.compressed else Image
        self._is_compressed = topics.compressed
        self._images = self.create_publisher(kind, topics.image, 1)
        self._states = self.create_publisher(JointState, topics.joint_states, 1)
        if topics.positions:
            self.create_subscription(
                Float64MultiArray, topics.positions, self._follow_array, 1
            )
        else:
            self.create_subscription(
                JointTrajectory, topics.trajectory, self._follow_point, 1
            )
        self.ticks = 0
        self._queue: list[tuple[Any, Any]] = []

    def play(self, episode: Episodes, periods: int) -> bool:
        """Play one episode for at most some control periods; return whether it succeeded."""
        self.ticks, self.commands, self._queue = 0, 0, []
        self.running.reset(None, {"episodes": episode})
        self.arm.command = None
        for _ in range(periods):
            self.running.move(np.zeros((1, len(self.joint_map.moved))))
            if self.running.success[0]:
                return True
        return False

    def _follow_point(self, message: Any) -> None:
        wanted = dict(
            zip(message.joint_names, message.points[-1].positions, strict=True)
        )
        self._follow([wanted[name] for name in self.joint_map.names])

    def _follow_array(self, message: Any) -> None:
        self._follow(message.data)

    def _follow(self, positions: Any) -> None:
        self.arm.command = self.joint_map.from_real(positions)
        self.commands += 1

    def _tick(self) -> None:
        now = self.now()
        pixels = draw_images(self._renderer, self.running)[0]
        positions = self.joint_map.to_real(self.arm.joint_positions[0])
        state = JointState(name=list(self.joint_map.names), position=positions.tolist())
        image: Any = CompressedImage(format="png")
        if self._is_compressed:
            image.data = encode(pixels, "PNG")
        else:
            image = Image(encoding="rgb8", height=len(pixels), width=len(pixels))
            image.step, image.data = 3 * len(pixels), pixels.tobytes()
        image.header.stamp = state.header.stamp = now
        self._queue.append((image, state))
        if len(self._queue) > self.late:
            image, state = self._queue.pop(0)
            self._images.publish(image)
            self._states.publish(state)
        self.ticks += 1
        self.wait()

    def now(self) -> Any:
        """Return the time of a tick, a message."""
        return self.get_clock().now().to_msg()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path, help="run folder, for its environment")
    parser.add_argument("--episodes", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--seconds", type=float, default=60, help="longest time of an episode"
    )
    arguments = parser.parse_args()
    config = load_agent(arguments.run).config.env
    rclpy.init()
    executor = SingleThreadedExecutor()

    def wait() -> None:
        end = time.monotonic() + TICK_S
        while (left := end - time.monotonic()) > 0:
            executor.spin_once(timeout_sec=left)

    robot = RobotNode(config, Topics(), wait)
    executor.add_node(robot)
    episodes = evaluation_episodes(config, arguments.episodes, arguments.seed)
    rows = config.task.asked.knowledge_rows(facets_of(config))
    for number in range(arguments.episodes):
        robot.running.reset(None, {"episodes": episodes[number : number + 1]})
        print(f"knowledge: {rows[robot.running.knowledge_input[0]]}", flush=True)
        periods = round(arguments.seconds / CONTROL_PERIOD_S)
        solved = robot.play(episodes[number : number + 1], periods)
        about = robot.running.describe(0)
        print(
            f"{about}: {'reached' if solved else 'not reached'} by {robot.commands} commands"
        )


if __name__ == "__main__":
    main()
