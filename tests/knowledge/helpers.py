"""Knowledge configs and files shared by the tests of the knowledge."""

from knowarm.experiment.agents import AGENTS

KNOWLEDGE = {
    name: agent.knowledge for name, agent in AGENTS.items() if agent.knowledge.scope != "query"
}
"""Knowledge of every registered agent that describes scenes or targets, by the agent's name."""
