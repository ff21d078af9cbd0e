"""What an agent knows: nothing, vectors from a graph, or what a network recognizes by them.

A member of `Knows` builds the knowledge table and the input of the policy, in training and tests.
"""

from knowarm.experiment.knows.grounded import GraphAnswers, GroundedVector
from knowarm.experiment.knows.member import NoKnowledge, Reasoning
from knowarm.experiment.knows.vectors import (
    QueryVector,
    SceneVector,
    TargetVector,
)

Knows = NoKnowledge | SceneVector | TargetVector | QueryVector | GroundedVector | GraphAnswers
"""What an agent knows, told apart by ``kind``."""

__all__ = [
    "GraphAnswers",
    "GroundedVector",
    "Knows",
    "NoKnowledge",
    "QueryVector",
    "Reasoning",
    "SceneVector",
    "TargetVector",
]
