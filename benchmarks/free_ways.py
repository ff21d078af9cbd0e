"""Layouts in which the oracle finds a way that touches nothing, and its success there.

python -m benchmarks.free_ways --robot tiago --task choose-lift --episodes 500
"""

import argparse

from knowarm import ArmVectorEnv, EnvConfig, OracleAgent, evaluation_episodes, play
from knowarm.world.tasks.skills.lift.guide import LiftGuide

SEED = 1_000_003  # Of the episodes of `knowarm evaluate`


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", default="tiago")
    parser.add_argument("--task", default="choose-lift")
    parser.add_argument("--episodes", type=int, default=500)
    args = parser.parse_args()
    env = ArmVectorEnv(EnvConfig(robot=args.robot, task=args.task), args.episodes)
    oracle = OracleAgent(env)
    episodes = evaluation_episodes(env.config, args.episodes, SEED)
    success = play(oracle, env, episodes).success
    assert isinstance(oracle.guide, LiftGuide)
    is_free = oracle.guide.is_free
    print(f"free way: {100 * is_free.mean():.1f} % of {args.episodes} layouts")
    print(f"success: {100 * success.mean():.1f} %")
    print(f"success on free ways: {100 * success[is_free].mean():.1f} %")


if __name__ == "__main__":
    main()
