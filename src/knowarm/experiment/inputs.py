"""Knowledge input of a policy: rows of a table, or what a network recognizes in the image."""

from dataclasses import dataclass
from typing import Any, Protocol, cast

import numpy as np

from knowarm.experiment.config import ExperimentConfig
from knowarm.experiment.other_graphs import answer_table
from knowarm.perception.answering import AnswerGrounding
from knowarm.perception.classifier import FacetClassifier, NamedFacet
from knowarm.perception.grounding import FrameRecognition, GroundingNetwork
from knowarm.perception.module import PerceptionModule
from knowarm.policy import Policy, PolicyAgent
from knowarm.world.config import EnvConfig
from knowarm.world.envs.torch_env import TorchArmVectorEnv


class KnowledgeInput(Protocol):
    """Where a policy's knowledge comes from: a table, or a `Recognition`."""

    def make_env(self, config: EnvConfig, num_envs: int, **options: Any) -> TorchArmVectorEnv:
        """Make training environments with this knowledge; options as `TorchArmVectorEnv`."""

    def make_agent(self, policy: Policy, **options: Any) -> PolicyAgent:
        """Make an agent with this knowledge; options as `PolicyAgent`."""


@dataclass(frozen=True)
class KnowledgeTable:
    """A table as the input of a policy."""

    table: np.ndarray
    """(rows, K) float32, one row per `Task.knowledge_rows`; K may be 0."""

    def make_env(self, config: EnvConfig, num_envs: int, **options: Any) -> TorchArmVectorEnv:
        """As `KnowledgeInput.make_env`."""
        return TorchArmVectorEnv(config, num_envs, table=self.table, **options)

    def make_agent(self, policy: Policy, **options: Any) -> PolicyAgent:
        """As `KnowledgeInput.make_agent`."""
        return PolicyAgent(policy, self.table, **options)


def knowledge_input(
    config: ExperimentConfig, table: np.ndarray, module: PerceptionModule | None
) -> KnowledgeInput:
    """Return the input of an experiment's policy, from its table and its trained module, if any."""
    if module is None:
        return KnowledgeTable(table)
    if config.grounding is None:
        return NamedFacet(cast(FacetClassifier, module), config.env, table)
    network = cast(GroundingNetwork, module)
    if config.reasoning == "vector":
        return FrameRecognition(network)
    return AnswerGrounding(network, answer_table(config, config.env, network.spec.facets))
