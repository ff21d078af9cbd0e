"""Knowledge configs shared by the tests of the knowledge."""

from knowarm.experiment.agents import AGENTS

KNOWLEDGE = {name: agent.knowledge for name, agent in AGENTS.items()}
"""Knowledge of every registered agent, by the agent's name."""
