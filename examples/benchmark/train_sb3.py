"""Train Stable-Baselines3's PPO on the reach task of the benchmark, and save it as a policy for it.

    pip install 'knowarm[sb3]'
    python examples/benchmark/train_sb3.py --steps 200000
    knowarm benchmark run reach-v1 --policy stable_baselines3:PPO:sb3-reach.zip --cells irb120-fixed

Training draws its own episodes of the cell's task. Only the benchmark plays the frozen ones.
"""

import argparse

from stable_baselines3 import PPO

from knowarm import ArmVectorEnv, SB3VecEnv
from knowarm.benchmark.suites import read_suite

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=200_000)
    steps = parser.parse_args().steps

    cell = read_suite("reach-v1").cells["irb120-fixed"]
    env = SB3VecEnv(ArmVectorEnv(cell.env, 64), seed=0)
    model = PPO(
        "CnnPolicy", env, n_steps=25, batch_size=400, n_epochs=2, seed=0, verbose=1
    )
    model.learn(steps)
    model.save("sb3-reach")
