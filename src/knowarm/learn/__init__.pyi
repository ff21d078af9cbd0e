# Public names of the package: what type checkers see, and what __init__.py imports on first use.
from .a3c import A3CTrainer as A3CTrainer
from .algorithms import A3CConfig as A3CConfig
from .algorithms import PPOConfig as PPOConfig
from .checkpoint import Checkpoint as Checkpoint
from .checkpoint import CheckpointStore as CheckpointStore
from .checkpoint import read_checkpoint as read_checkpoint
from .environment import NumpyToTorch as NumpyToTorch
from .environment import TorchVectorEnv as TorchVectorEnv
from .evaluation import MakeEvaluate as MakeEvaluate
from .evaluation import Metrics as Metrics
from .ppo import PPOTrainer as PPOTrainer
from .trainer import Hooks as Hooks
from .trainer import Trainer as Trainer
from .trainer import TrainingResult as TrainingResult
