"""Knowledge input of a policy: rows of a table, or what a network recognizes in the image."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from knowarm.perception.agent import FrameRecognition
from knowarm.policy import Policy, PolicyAgent
from knowarm.world.config import EnvConfig
from knowarm.world.envs.torch_env import TorchArmVectorEnv


@dataclass(frozen=True)
class KnowledgeTable:
    """A table as the input of a policy."""

    table: np.ndarray
    """(rows, K) float32, one row per `Task.knowledge_rows`; K may be 0."""

    def make_env(
        self, config: EnvConfig, num_envs: int, num_threads: int = 0, **options: Any
    ) -> TorchArmVectorEnv:
        """Make training environments with this knowledge; options as `TorchArmVectorEnv`."""
        return TorchArmVectorEnv(
            config, num_envs, table=self.table, num_threads=num_threads, **options
        )

    def make_agent(self, policy: Policy, **options: Any) -> PolicyAgent:
        """Make an agent with this knowledge; options as `PolicyAgent`."""
        return PolicyAgent(policy, self.table, **options)


KnowledgeInput = KnowledgeTable | FrameRecognition
"""Where a policy's knowledge comes from."""
