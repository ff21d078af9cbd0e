"""Train sb3-contrib's RecurrentPPO on KnowArm's images and knowledge.

    pip install 'knowarm[sb3]'
    python examples/train_with_sb3.py --steps 200000

The observation is a Dict of ``image`` and ``knowledge``, so that ``MultiInputLstmPolicy`` works
unchanged. `SB3VecEnv` steps all environments at once; the ordinary way, a list of single
environments in a ``DummyVecEnv``, works too and is slower (see ``--single``).
"""

import argparse

from sb3_contrib import RecurrentPPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

import knowarm


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--experiment", default="irb120-full-ppo")
    parser.add_argument("--steps", type=int, default=200_000)
    parser.add_argument("--runs", default="runs")
    parser.add_argument("--envs", type=int, default=64)
    parser.add_argument(
        "--single", action="store_true", help="step environments one by one"
    )
    arguments = parser.parse_args()

    chosen = knowarm.experiment_config(arguments.experiment)
    table = chosen.knows.known(chosen.env, chosen.seed).table
    shown = {"observe": ("image", "knowledge"), "knowledge": table}
    if arguments.single:
        alone = [lambda: knowarm.ArmEnv(**shown, **vars(chosen.env))] * arguments.envs
        env = VecMonitor(DummyVecEnv(alone))  # logs return and length of the episodes
    else:
        env = knowarm.SB3VecEnv(
            knowarm.ArmVectorEnv(chosen.env, arguments.envs, **shown), seed=0
        )
    model = RecurrentPPO(
        "MultiInputLstmPolicy",
        env,
        n_steps=25,
        batch_size=25 * arguments.envs // 4,
        n_epochs=2,
        gae_lambda=0.95,
        ent_coef=0.01,
        verbose=1,
    )
    # A run folder in runs/, which `knowarm report` shows beside KnowArm's own
    model.learn(arguments.steps, callback=knowarm.SB3Run(chosen, arguments.runs))
    model.save("sb3-irb120")


if __name__ == "__main__":
    main()
