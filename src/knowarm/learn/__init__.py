"""Learning algorithms: recurrent PPO and A3C on torch vector environments.

A trainer (`ppo`, `a3c`, both on `trainer`) steps a vector environment (`environment`) with a
`collector` that fills a `rollout`; `returns` and `losses` define what is learned from it. PPO's
`learner` computes in one process or, with `data_parallel`, in several. `evaluation` runs interim
evaluations, `guards` stop at non-finite values, `checkpoint` saves and resumes.
"""

from knowarm.learn.a3c import A3CTrainer
from knowarm.learn.algorithms import A3CConfig, PPOConfig
from knowarm.learn.checkpoint import Checkpoint, CheckpointStore, read_checkpoint
from knowarm.learn.environment import (
    NumpyToTorch,
    PrivilegedVectorEnv,
    TeachingVectorEnv,
    TorchVectorEnv,
)
from knowarm.learn.evaluation import Evaluate, MakeEvaluate, Metrics
from knowarm.learn.ppo import PPOTrainer
from knowarm.learn.trainer import Hooks, Trainer, TrainingResult

__all__ = [
    "A3CConfig",
    "A3CTrainer",
    "Checkpoint",
    "CheckpointStore",
    "Evaluate",
    "Hooks",
    "MakeEvaluate",
    "Metrics",
    "NumpyToTorch",
    "PPOConfig",
    "PPOTrainer",
    "PrivilegedVectorEnv",
    "TeachingVectorEnv",
    "TorchVectorEnv",
    "Trainer",
    "TrainingResult",
    "read_checkpoint",
]
