"""Solvability of each task: reachability, oracle, random agent and servo error.

python -m benchmarks.oracle --episodes 300 --json oracle.json
"""

import argparse
import json
from pathlib import Path
from typing import Literal

import numpy as np

from knowarm.world.agents.play import play
from knowarm.world.agents.protocol import Batch
from knowarm.world.agents.scripted import OracleAgent, RandomAgent
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.objects import TARGETS
from knowarm.world.robots import ROBOTS
from knowarm.world.tasks.skills.ik import InverseKinematics

SEED = 7

Dynamics = Literal["dynamic", "kinematic"]


def task_row(robot: str, target: str, dynamics: Dynamics, episodes: int) -> dict:
    """Measure reachability and the success of oracle and random agent."""
    config = EnvConfig(robot=robot, targets=(target,), dynamics=dynamics, image_size=8)
    env = ArmVectorEnv(config, episodes)
    fixed = evaluation_episodes(config, episodes, SEED)
    env.reset(options={"episodes": fixed})
    solution = InverseKinematics(env.scene).solve(
        env.running.goal_position, env.running.goal_matrix, env.joint_positions
    )
    oracle = play(OracleAgent(env), env, fixed)
    random = play(RandomAgent(SEED), env, fixed)
    reached = solution.within(config.success_distance_m, config.success_angle_deg)
    return {
        "robot": robot,
        "target": target,
        "dynamics": dynamics,
        "reachable": float(reached.mean()),
        "oracle_success": float(oracle.success.mean()),
        "oracle_steps_median": float(np.median(oracle.length)),
        "oracle_steps_p95": float(np.percentile(oracle.length, 95)),
        "random_success": float(random.success.mean()),
        "random_return": float(random.episode_return.mean()),
    }


def tracking_row(robot: str, dynamics: Dynamics, episodes: int) -> dict:
    """Measure the distance of joints from their targets after actions of a random agent [rad]."""
    env = ArmVectorEnv(
        EnvConfig(robot=robot, dynamics=dynamics, image_size=8), episodes
    )
    env.reset(options={"episodes": evaluation_episodes(env.config, episodes, SEED)})
    agent = RandomAgent(SEED)
    agent.reset(Batch.of(env))
    no_env = np.zeros(episodes, dtype=np.bool_)
    lags = []
    for _ in range(env.config.max_episode_steps):
        env.advance(agent.act({}), no_env)
        lags.append(np.abs(env.joint_positions - env.joint_targets))
    lag = np.stack(lags)
    return {
        "robot": robot,
        "dynamics": dynamics,
        "tracking_mean_rad": float(lag.mean()),
        "tracking_p99_rad": float(np.percentile(lag, 99)),
        "tracking_max_rad": float(lag.max()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--episodes", type=int, default=300)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    tasks, tracking = [], []
    for robot in ROBOTS:
        for dynamics in ("dynamic", "kinematic"):
            for target in TARGETS:
                tasks.append(task_row(robot, target, dynamics, arguments.episodes))
                print(tasks[-1], flush=True)
            tracking.append(tracking_row(robot, dynamics, arguments.episodes))
            print(tracking[-1], flush=True)
    if arguments.json:
        arguments.json.write_text(
            json.dumps({"tasks": tasks, "tracking": tracking}, indent=2)
        )


if __name__ == "__main__":
    main()
