"""``knowarm list``: robots, targets, agents, algorithms and experiments."""

from dataclasses import dataclass
from typing import Any

from knowarm.cli.tables import TableCommand, print_table
from knowarm.experiment.agents import AGENTS
from knowarm.experiment.algorithms import ALGORITHMS
from knowarm.experiment.names import experiment_names
from knowarm.learn.algorithms import privileged_uses
from knowarm.world import env_id
from knowarm.world.agents import SCRIPTED_AGENTS
from knowarm.world.objects import TARGETS
from knowarm.world.robots import ROBOTS
from knowarm.world.robots.menagerie import HOW_TO_GET, known_arms
from knowarm.world.tasks import task_names


@dataclass(frozen=True, kw_only=True)
class List(TableCommand):
    """List robots, targets, agents, algorithms and experiments."""

    def result(self) -> dict[str, Any]:
        """Print one table per kind."""
        rows: list[list[Any]] = [
            [name, entry.title, ", ".join(env_id(name, task) for task in task_names())]
            for name, entry in ROBOTS.items()
        ]
        print_table("Robots", ["robot", "name", "Gymnasium ids"], rows)
        arms = known_arms()
        rows = [[arm.name, arm.title, str(arm.mjcf or "missing")] for arm in arms]
        title = "Known arms, whose files are in the MuJoCo Menagerie"
        print_table(title, ["robot", "name", "file"], rows)
        if any(arm.mjcf is None for arm in arms):
            print(f"To get the missing files: {HOW_TO_GET}.\n")
        grounded = "; grounded by the simulator's labels in training"
        rows = [
            [name, agent.role, agent.about + grounded * (agent.grounding is not None)]
            for name, agent in AGENTS.items()
        ]
        print_table("Agents", ["agent", "role", "description"], rows)
        rows = [
            [name, each.total_steps, ", ".join(privileged_uses(vars(each.config))), each.about]
            for name, each in ALGORITHMS.items()
        ]
        columns = ["algorithm", "steps", "simulator's state in training", "description"]
        print_table("Algorithms", columns, rows)
        rows = [[name, agent.about] for name, agent in SCRIPTED_AGENTS.items()]
        title = "Scripted agents, for `knowarm evaluate` and `knowarm view`"
        print_table(title, ["agent", "description"], rows)
        print(f"Targets: {', '.join(TARGETS)}\n")
        examples = experiment_names()
        print(
            "An experiment is named ROBOT-AGENT-ALGORITHM, or ROBOT-AGENT-dr-ALGORITHM with\n"
            "randomized colours of the targets, or ROBOT-choose-AGENT-ALGORITHM with several\n"
            "objects, of which a query means one. Train one, for example:\n"
            f"  knowarm train {examples[0]}\n"
            f"  knowarm train {examples[-1]}"
        )
        return {
            "robots": {name: entry.title for name, entry in ROBOTS.items()},
            "known_arms": {arm.name: arm.title for arm in arms},
            "targets": list(TARGETS),
            "agents": {name: agent.about for name, agent in AGENTS.items()},
            "roles": {name: agent.role for name, agent in AGENTS.items()},
            "algorithms": list(ALGORITHMS),
            "scripted_agents": list(SCRIPTED_AGENTS),
            "experiments": examples,
        }
