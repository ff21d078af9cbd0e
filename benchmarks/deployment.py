"""Success of one policy in process, by ONNX Runtime, served, and driven over ROS 2, same episodes.

python -m benchmarks.deployment RUN [--episodes 200] [--delays 0 .04 .1 .2] [--json FILE]

Needs the extras onnx, serve and ros. Robot and driver are ROS nodes of one process on the time of
/clock, so that the machine's load changes nothing: the clock goes on once every message of a tick
has arrived. A delay is the age of images and joint angles when they are published.
"""

import argparse
import json
import os
import tempfile
import threading
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rosgraph_msgs.msg import Clock

from examples.ros_robot import TICK_S, RobotNode
from knowarm.deploy import ros
from knowarm.deploy.client import Client
from knowarm.deploy.contract import Deployment, deployment, export, tcp_position
from knowarm.deploy.driver import Driver, Safety, Topics
from knowarm.deploy.ros import DriverNode
from knowarm.deploy.runner import Runner
from knowarm.deploy.serve import PolicyServer
from knowarm.experiment.load import load_agent
from knowarm.statistics.bootstrap import wilson
from knowarm.world.agents.play import EpisodeResults, play
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.scene.compose import CONTROL_PERIOD_S
from knowarm.world.tasks.sampling import Episodes


class Watched(Driver):
    """Driver that counts what has arrived."""

    images = states = 0

    def see(self, image: Any, stamp_s: float) -> None:
        super().see(image, stamp_s)
        self.images += 1

    def feel(
        self, names: Any, positions: Any, stamp_s: float, source: str = ""
    ) -> None:
        super().feel(names, positions, stamp_s, source)
        self.states += 1


class ClockedRobot(RobotNode):
    """Robot on the time of /clock, which waits for every message of a tick."""

    node: DriverNode
    driver: Watched

    def __init__(
        self, config: EnvConfig, topics: Topics, delay_s: float, joint_map: Path | None
    ) -> None:
        super().__init__(config, topics, self._wait, delay_s, joint_map)
        self._now, self._topics = 10**9, topics
        self._clock = self.create_publisher(Clock, "/clock", 1)
        self.executor_ = SingleThreadedExecutor()
        self.executor_.add_node(self)

    def now(self) -> Any:
        return rclpy.time.Time(nanoseconds=self._now).to_msg()

    def play_with(self, driver: Watched, episode: Episodes, periods: int) -> bool:
        """Play an episode with a driver."""
        self.node, self.driver = DriverNode(driver, self._topics), driver
        self.executor_.add_node(self.node)
        topic = self._topics.positions or self._topics.trajectory
        self._spin_until(
            lambda: (
                self.node.count_publishers(topic)
                == self.node.count_subscribers(topic)
                == 1
            )
        )
        solved = self.play(episode, periods)
        self.executor_.remove_node(self.node)
        self.node.destroy_node()
        return solved

    def _spin_until(self, done: Callable[[], bool]) -> None:
        for _ in range(3000):
            if done():
                return
            self.executor_.spin_once(timeout_sec=0.01)
        raise RuntimeError("a message was lost")

    def _wait(self) -> None:
        driver, seen = self.driver, max(self.ticks - self.late, 0)
        self._spin_until(lambda: driver.images == driver.states == seen)
        if not driver.end:
            self._clock.publish(Clock(clock=self.now()))
            self._spin_until(
                lambda: self.node.get_clock().now().nanoseconds == self._now
            )
            timer = next(iter(self.node.timers))
            self._spin_until(lambda: not timer.is_ready())
            self._spin_until(lambda: self.commands == driver.steps)
        self._now += round(TICK_S * 1e9)


def by_ros(
    config: EnvConfig,
    parts: Deployment,
    episodes: Episodes,
    delay_s: float,
    joint_map: Path | None = None,
    **topics: Any,
) -> tuple[np.ndarray, list[str]]:
    """Play episodes by two ROS nodes; return success and how the failed ones ended.

    ``joint_map`` is that of ``parts``, ``topics`` are fields of `Topics`.
    """
    ros.DISCOVERY_S = 0.0  # `play_with` waits until both nodes know each other
    rclpy.init(domain_id=1 + os.getpid() % 100)
    robot = ClockedRobot(config, Topics(use_clock=True, **topics), delay_s, joint_map)
    rows = parts.contract["knowledge"]["rows"]
    periods = config.max_episode_steps + 2 + round(delay_s / CONTROL_PERIOD_S)
    safety = Safety(confirm_steps=0, max_age_s=delay_s + 0.3)
    solved, ends = [], []
    for number in range(len(episodes)):
        episode = episodes[number : number + 1]
        robot.running.reset(None, {"episodes": episode})
        row = rows[int(robot.running.knowledge_input[0]) if len(rows) > 1 else 0]
        driver = Watched(
            parts.runner(), partial(tcp_position, parts.scene), safety, row
        )
        solved.append(robot.play_with(driver, episode, periods))
        ends += [] if solved[-1] else [driver.status]
    robot.executor_.shutdown()
    rclpy.shutdown()
    return np.array(solved), ends


def same(one: EpisodeResults, other: EpisodeResults) -> bool:
    """Return whether all joint angles are equal; at a limit, different levels command the same."""
    return bool(np.array_equal(one.steps.joint_positions, other.steps.joint_positions))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("--episodes", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--delays", type=float, nargs="*", default=[0, 0.04, 0.1, 0.2])
    parser.add_argument("--only-ros", action="store_true")
    parser.add_argument("--joint-map", type=Path)
    parser.add_argument("--positions", default="")
    parser.add_argument("--compressed", action="store_true")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    trained = load_agent(arguments.run)
    config, parts = trained.config.env, deployment(trained, arguments.joint_map)
    topics = {"positions": arguments.positions, "compressed": arguments.compressed}
    episodes = evaluation_episodes(config, arguments.episodes, arguments.seed)
    rows: dict[str, dict[str, Any]] = {}

    def add(name: str, solved: np.ndarray, **more: Any) -> None:
        count = int(np.sum(solved))
        found = wilson(count, len(solved))
        low, high = found.low, found.high
        row = {"success": count / len(solved), "low": low, "high": high, **more}
        rows[name] = row
        shares = f"{100 * row['success']:.1f} [{100 * low:.1f}, {100 * high:.1f}]"
        print(f"| {arguments.run.name} | {name} | {shares} | {more or ''}", flush=True)

    if not arguments.only_ros:
        ours = play(trained.agent, ArmVectorEnv(config, 1), episodes)
        add("in process", ours.success)
        with tempfile.TemporaryDirectory() as folder:
            export(trained, Path(folder), arguments.joint_map)
            theirs = play(Runner.load(folder), ArmVectorEnv(config, 1), episodes)
        add("ONNX Runtime", theirs.success, same_joints=same(theirs, ours))
        server = PolicyServer(parts.runner, port=0)
        threading.Thread(target=server.run, daemon=True).start()
        client = Client(f"ws://127.0.0.1:{server.port}")
        theirs = play(client, ArmVectorEnv(config, 1), episodes)
        server.close()
        add("served", theirs.success, same_joints=same(theirs, ours))
    for delay_s in arguments.delays:
        solved, ends = by_ros(
            config, parts, episodes, delay_s, arguments.joint_map, **topics
        )
        add(
            f"ROS 2, {1000 * delay_s:.0f} ms",
            solved,
            failed=dict(Counter(ends).most_common(3)),
        )
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
