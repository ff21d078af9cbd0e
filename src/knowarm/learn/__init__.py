"""A policy, environments and a knowledge table go in; a trained policy comes out.

The path through the files: `collector` (arrays) or `tensor_collector` (tensors of a device) fills a
`rollout`, `returns` and `losses` judge it, `ppo` and `a3c` learn from it, `guards` watch,
`checkpoint` keeps. A `learner` does PPO's arithmetic: one process (`solo`) or several (`team`).
"""

from knowarm.learn.checkpoint import Checkpoint, CheckpointStore, read_checkpoint
from knowarm.learn.config import A3CConfig, PPOConfig
from knowarm.learn.ppo import PPOTrainer
from knowarm.learn.trainer import Evaluate, Hooks, Metrics, TrainingResult

__all__ = [
    "A3CConfig",
    "Checkpoint",
    "CheckpointStore",
    "Evaluate",
    "Hooks",
    "Metrics",
    "PPOConfig",
    "PPOTrainer",
    "TrainingResult",
    "read_checkpoint",
]
