# Public names of the package: what type checkers see, and what __init__.py imports on first use.
from .errors import UserError as UserError
from .experiment.agents import AGENTS as AGENTS
from .experiment.agents import Agent as Agent
from .experiment.algorithms import ALGORITHMS as ALGORITHMS
from .experiment.algorithms import Algorithm as Algorithm
from .experiment.build import TrainedAgent as TrainedAgent
from .experiment.build import load_agent as load_agent
from .experiment.config import EvaluationConfig as EvaluationConfig
from .experiment.config import ExperimentConfig as ExperimentConfig
from .experiment.evaluate import EvaluationResult as EvaluationResult
from .experiment.evaluate import evaluate as evaluate
from .experiment.registry import experiment_config as experiment_config
from .experiment.registry import experiment_names as experiment_names
from .experiment.run import Run as Run
from .experiment.run import train as train
from .knowledge.config import KnowledgeConfig as KnowledgeConfig
from .knowledge.embedding import SceneEmbedding as SceneEmbedding
from .knowledge.embedding import scene_embedding as scene_embedding
from .knowledge.formats import read_graph as read_graph
from .knowledge.graph import KnowledgeGraph as KnowledgeGraph
from .learn.config import A3CConfig as A3CConfig
from .learn.config import PPOConfig as PPOConfig
from .policy import Policy as Policy
from .policy import PolicyAgent as PolicyAgent
from .policy import PolicyConfig as PolicyConfig
from .policy import PolicyShape as PolicyShape
from .report import write_report as write_report
from .world import make as make
from .world.config import EnvConfig as EnvConfig
from .world.objects import TARGETS as TARGETS
from .world.robots import ROBOTS as ROBOTS
from .world.torch_env import TorchReachVectorEnv as TorchReachVectorEnv
from .world.vector_env import ReachVectorEnv as ReachVectorEnv

__version__: str
