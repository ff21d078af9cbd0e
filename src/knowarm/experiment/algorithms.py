"""Registry of learning algorithms: default config, trainer and training length of each.

One of another package is found by its entry point in the group "knowarm.algorithms", by the
environment variable ``KNOWARM_ALGORITHMS``, or after `register_algorithm`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from knowarm.errors import UserError
from knowarm.learn.algorithms import (
    A3CConfig,
    AlgorithmConfig,
    DistilConfig,
    PPOConfig,
    PrivilegedConfig,
    SeenConfig,
)
from knowarm.own import installed, load, named_by, share

if TYPE_CHECKING:
    from knowarm.learn import TorchVectorEnv, Trainer
    from knowarm.policy import Policy

    MakeEnv = Callable[..., TorchVectorEnv]

GROUP = "knowarm.algorithms"
"""Group of the entry points of other packages."""

VARIABLE = "KNOWARM_ALGORITHMS"
"""Environment variable with further ones, as ``package.module:Name`` separated by commas."""


@dataclass(frozen=True, kw_only=True)
class Algorithm:
    """One learning algorithm and the defaults of its experiments."""

    about: str
    """One line for ``knowarm list``."""
    config: AlgorithmConfig
    """Default hyperparameters; their literal ``name`` is the registry's name of the trainer."""
    make_trainer: "Callable[..., Trainer]"
    """Builds a trainer from ``config``, the ``policy`` that it trains in place, and ``make_env``,
    which makes a number of environments of the experiment and can be pickled. Further options are
    those of `knowarm.learn.Trainer`."""
    total_steps: int
    """Environment steps of an experiment, over all environments."""
    policy: Mapping[str, Any] = field(default_factory=dict)
    """Fields of the policy's config that have other values under this algorithm."""
    grounded: Mapping[str, Any] = field(default_factory=dict)
    """The same for agents whose policy receives the grasp frame of a grounding network."""
    needs_grounding: bool = False
    """Whether it is for agents with a grounding network only."""


# Trainers are imported when they are made: they import torch, which naming an experiment does not
# need.


def _make_synchronous(
    config: PPOConfig | DistilConfig,
    policy: "Policy",
    make_env: "MakeEnv",
    **options: Any,
) -> "Trainer":
    from knowarm.learn import DistilTrainer, PPOTrainer

    env = make_env(config.num_envs, device=config.device)
    if isinstance(config, DistilConfig):
        return DistilTrainer(config, policy, env, **options)
    return PPOTrainer(config, policy, env, **options)


def _make_a3c(
    config: A3CConfig,
    policy: "Policy",
    make_env: "MakeEnv",
    **options: Any,
) -> "Trainer":
    from knowarm.learn import A3CTrainer, FixedScheduleA3CTrainer

    if config.is_fixed:
        return FixedScheduleA3CTrainer(config, policy, make_env, **options)
    return A3CTrainer(config, policy, make_env, **options)


def _make_untrained(
    config: SeenConfig,
    policy: "Policy",
    make_env: "MakeEnv",
    **options: Any,
) -> "Trainer":
    from knowarm.learn.trainer import UntrainedTrainer

    return UntrainedTrainer(policy, **options)


CENTRED_PIXELS = {"pixel_shift": 0.5, "pixel_scale": 4.0}

ALGORITHMS: dict[str, Algorithm] = {
    "fast": Algorithm(
        about="PPO with Muon, larger thresholds at first, and a critic on the simulator's state",
        config=PPOConfig(
            optimizer="muon",
            learning_rate=3e-3,
            epochs=1,
            minibatches=8,
            privileged=PrivilegedConfig(
                critic=True,
                auxiliary_coef=1.0,
                threshold_factor=3.0,
                threshold_decrease=0.05,
            ),
        ),
        make_trainer=_make_synchronous,
        total_steps=1_500_000,
        policy=CENTRED_PIXELS,
    ),
    "distil": Algorithm(
        about="imitation of a teacher by inverse kinematics, in the states the policy visits",
        config=DistilConfig(),
        make_trainer=_make_synchronous,
        total_steps=200_000,
        policy=CENTRED_PIXELS,
        # The auxiliary loss predicts the way to the goal, so its features have to know the goal.
        grounded={"fusion": "before_fc"},
    ),
    "ppo": Algorithm(
        about="recurrent proximal policy optimization",
        config=PPOConfig(),
        make_trainer=_make_synchronous,
        total_steps=10_000_000,
        policy=CENTRED_PIXELS,
    ),
    "a3c": Algorithm(
        about="asynchronous advantage actor-critic with the paper's numbers",
        config=A3CConfig(),
        make_trainer=_make_a3c,
        total_steps=70_000_000,
        policy={"fc_activation": "none", "actor_gain": 1.0},
    ),
    "a3c-tuned": Algorithm(
        about="A3C with two batched workers, larger thresholds at first, PPO's rewards and pixels",
        config=A3CConfig(
            workers=2,
            envs_per_worker=128,
            rollout_steps=10,
            rollout_ends_with_episode=False,
            bootstrap_at_time_limit=True,
            learning_rate=1e-3,
            learning_rate_schedule="linear",
            rmsprop_eps=1e-5,
            gamma=0.95,
            gae_lambda=0.95,
            vf_coef=0.5,
            ent_coef=0.001,
            reward_scale=0.05,
            max_grad_norm=0.5,
            threshold_factor=3.0,
            threshold_decrease=0.01,
            matmul_precision="auto",
        ),
        make_trainer=_make_a3c,
        total_steps=10_000_000,
        policy=CENTRED_PIXELS,
    ),
    "seen": Algorithm(
        about="no policy: inverse kinematics move to what the grounding network sees",
        config=SeenConfig(),
        make_trainer=_make_untrained,
        total_steps=1,
        policy={"features": 1, "hidden": 1},  # It plays no part.
        needs_grounding=True,
    ),
}
"""Algorithms by name; the first is that of the default experiment. See `algorithms`."""

DEMO_ALGORITHM = "distil"
"""Algorithm of the demo: the fastest to a trained arm."""


def algorithms() -> dict[str, Algorithm]:
    """Return all algorithms by name: shipped, installed and registered."""
    for import_path in (*installed(GROUP).values(), *named_by(VARIABLE)):
        _add(import_path)
    return ALGORITHMS


def register_algorithm(import_path: str) -> Algorithm:
    """Add an algorithm of your own module to ``ALGORITHMS``, by the ``name`` of its config.

    Processes that this one starts know it, too.

    Args:
        import_path: where the `Algorithm` is, as ``package.module:Name``.

    Raises:
        UserError: it cannot be imported, is no algorithm, or has the name of another one.
    """
    algorithm = _add(import_path)
    share(VARIABLE, import_path)
    return algorithm


def _add(import_path: str) -> Algorithm:
    needed = "an instance of knowarm.Algorithm"
    algorithm: Algorithm = load(
        import_path, "algorithm", lambda value: isinstance(value, Algorithm), needed
    )
    if ALGORITHMS.setdefault(algorithm.config.name, algorithm) is not algorithm:
        raise UserError(
            f"The config of the algorithm {import_path} has the name {algorithm.config.name!r}, "
            "which another one has already; give its field ``name`` another literal."
        )
    return algorithm
