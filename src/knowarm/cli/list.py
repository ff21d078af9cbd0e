"""``knowarm list``: robots, targets, agents, algorithms and experiments."""

from dataclasses import dataclass

from knowarm.cli.tables import FilePath, check_json_path, print_table, write_json_table
from knowarm.experiment.agents import AGENTS, Agent
from knowarm.experiment.algorithms import ALGORITHMS
from knowarm.experiment.registry import experiment_names
from knowarm.learn.config import privileged_uses
from knowarm.world.agents import SCRIPTED_AGENTS
from knowarm.world.menagerie import HOW_TO_GET, known_arms
from knowarm.world.objects import TARGETS
from knowarm.world.robots import ROBOTS


@dataclass(frozen=True, kw_only=True)
class List:
    """List robots, targets, agents, algorithms and experiments."""

    json: FilePath = None
    """Also write the names to this JSON file."""

    def run(self) -> None:
        """Print one table per kind."""
        check_json_path(self.json)
        print_table(
            "Robots",
            ["robot", "name", "Gymnasium id"],
            [[name, entry.title, f"knowarm/{entry.env_id}"] for name, entry in ROBOTS.items()],
        )
        arms = known_arms()
        print_table(
            "Known arms, whose files are in the MuJoCo Menagerie",
            ["robot", "name", "file"],
            [[arm.name, arm.title, str(arm.mjcf or "missing")] for arm in arms],
        )
        if any(arm.mjcf is None for arm in arms):
            print(f"To get the missing files: {HOW_TO_GET}.\n")
        print_table(
            "Agents",
            ["agent", "role", "description"],
            [[name, agent.role, _about(agent)] for name, agent in AGENTS.items()],
        )
        print_table(
            "Algorithms",
            ["algorithm", "steps", "simulator's state in training", "description"],
            [
                [
                    name,
                    entry.total_steps,
                    ", ".join(privileged_uses(vars(entry.config))),
                    entry.about,
                ]
                for name, entry in ALGORITHMS.items()
            ],
        )
        print_table(
            "Scripted agents, for `knowarm evaluate` and `knowarm view`",
            ["agent", "description"],
            [[name, agent.about] for name, agent in SCRIPTED_AGENTS.items()],
        )
        print(f"Targets: {', '.join(TARGETS)}\n")
        examples = experiment_names()
        print(
            "An experiment is named ROBOT-AGENT-ALGORITHM, or ROBOT-AGENT-dr-ALGORITHM with\n"
            "randomized colours of the targets, or ROBOT-choose-AGENT-ALGORITHM with several\n"
            "objects, of which a query means one. Train one, for example:\n"
            f"  knowarm train {examples[0]}\n"
            f"  knowarm train {examples[-1]}"
        )
        write_json_table(
            self.json,
            {
                "robots": {name: entry.title for name, entry in ROBOTS.items()},
                "known_arms": {arm.name: arm.title for arm in arms},
                "targets": list(TARGETS),
                "agents": {name: agent.about for name, agent in AGENTS.items()},
                "roles": {name: agent.role for name, agent in AGENTS.items()},
                "algorithms": list(ALGORITHMS),
                "scripted_agents": list(SCRIPTED_AGENTS),
                "experiments": examples,
            },
        )


def _about(agent: Agent) -> str:
    """Describe an agent, and say what it learns from the simulator's labels beside its policy."""
    if agent.grounding is None:
        return agent.about
    return f"{agent.about}; grounded by the simulator's labels in training"
