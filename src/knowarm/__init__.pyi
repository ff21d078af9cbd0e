# Public names of the package: what type checkers see, and what __init__.py imports on first use.
from .errors import UserError as UserError
from .experiment.agents import AGENTS as AGENTS
from .experiment.agents import Agent as Agent
from .experiment.algorithms import ALGORITHMS as ALGORITHMS
from .experiment.algorithms import Algorithm as Algorithm
from .experiment.config import EvaluationConfig as EvaluationConfig
from .experiment.config import ExperimentConfig as ExperimentConfig
from .experiment.evaluate import EvaluationResult as EvaluationResult
from .experiment.evaluate import evaluate as evaluate
from .experiment.graph_queries import GraphQueries as GraphQueries
from .experiment.load import TrainedAgent as TrainedAgent
from .experiment.load import load_agent as load_agent
from .experiment.names import experiment_config as experiment_config
from .experiment.names import experiment_names as experiment_names
from .experiment.run import Run as Run
from .experiment.run import train as train
from .knowledge import query_embedding as query_embedding
from .knowledge.config import KnowledgeConfig as KnowledgeConfig
from .knowledge.embedding import SceneEmbedding as SceneEmbedding
from .knowledge.embedding import scene_embedding as scene_embedding
from .knowledge.formats import read_graph as read_graph
from .knowledge.graph.graph import KnowledgeGraph as KnowledgeGraph
from .knowledge.queries.queries import parse_query as parse_query
from .learn.algorithms import A3CConfig as A3CConfig
from .learn.algorithms import PPOConfig as PPOConfig
from .learn.environment import NumpyToTorch as NumpyToTorch
from .learn.sb3_vec_env import SB3VecEnv as SB3VecEnv
from .perception.classifier import FacetClassifier as FacetClassifier
from .perception.config import GroundingConfig as GroundingConfig
from .perception.config import PerceptionConfig as PerceptionConfig
from .perception.training import train_classifier as train_classifier
from .policy import Policy as Policy
from .policy import PolicyAgent as PolicyAgent
from .policy import PolicyConfig as PolicyConfig
from .policy import PolicyShape as PolicyShape
from .questions import Query as Query
from .questions import QuestionTable as QuestionTable
from .report import write_report as write_report
from .study.config import StudyConfig as StudyConfig
from .study.config import read_study as read_study
from .study.driver import run_study as run_study
from .world import make as make
from .world.agents import OracleAgent as OracleAgent
from .world.agents.play import play as play
from .world.config import EnvConfig as EnvConfig
from .world.envs.knowledge_observation import KnowledgeObservation as KnowledgeObservation
from .world.envs.knowledge_observation import (
    VectorKnowledgeObservation as VectorKnowledgeObservation,
)
from .world.envs.single_env import ReachEnv as ReachEnv
from .world.envs.torch_env import TorchReachVectorEnv as TorchReachVectorEnv
from .world.envs.vector_env import ReachVectorEnv as ReachVectorEnv
from .world.objects import TARGETS as TARGETS
from .world.robots import ROBOTS as ROBOTS
from .world.scene.appearance import VisualRandomization as VisualRandomization
from .world.tasks import TASKS as TASKS
from .world.tasks import register_task as register_task
from .world.tasks.choose.choose import Choose as Choose
from .world.tasks.choose.source import NameQueries as NameQueries
from .world.tasks.episodes import Episodes as Episodes
from .world.tasks.episodes import evaluation_episodes as evaluation_episodes
from .world.tasks.held_out import HeldOut as HeldOut
from .world.tasks.reach import Reach as Reach
from .world.tasks.task import Task as Task

__version__: str
