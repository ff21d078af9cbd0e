"""Knowledge configs and files shared by the tests of the knowledge."""

from knowarm.experiment.agents import AGENTS

KNOWLEDGE = {
    name: agent.knows
    for name, agent in AGENTS.items()
    if agent.knows.scope not in ("nothing", "query")
}
"""Knowledge of every registered agent that describes scenes or targets, by the agent's name."""
