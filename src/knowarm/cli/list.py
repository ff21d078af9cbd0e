"""``knowarm list``: robots, targets, agents, algorithms and experiments."""

from dataclasses import dataclass

from knowarm.cli.tables import FilePath, check_json_path, print_table, write_json_table
from knowarm.experiment.agents import AGENTS
from knowarm.experiment.algorithms import ALGORITHMS
from knowarm.experiment.registry import experiment_names
from knowarm.world.agents import SCRIPTED_AGENTS
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
        print_table("Robots", ["robot"], [[name] for name in ROBOTS])
        print_table(
            "Agents",
            ["agent", "description"],
            [[name, agent.about] for name, agent in AGENTS.items()],
        )
        print_table(
            "Algorithms",
            ["algorithm", "environment steps"],
            [[name, algorithm.total_steps] for name, algorithm in ALGORITHMS.items()],
        )
        print(f"Targets: {', '.join(TARGETS)}")
        print(f"Scripted agents for `evaluate` and `view`: {', '.join(SCRIPTED_AGENTS)}\n")
        examples = experiment_names()
        print(
            "An experiment is named ROBOT-AGENT-ALGORITHM, or ROBOT-AGENT-dr-ALGORITHM with\n"
            "randomized colours of the targets. Train one, for example:\n"
            f"  knowarm train {examples[0]}\n"
            f"  knowarm train {examples[-1]}"
        )
        write_json_table(
            self.json,
            {
                "robots": list(ROBOTS),
                "targets": list(TARGETS),
                "agents": {name: agent.about for name, agent in AGENTS.items()},
                "algorithms": list(ALGORITHMS),
                "scripted_agents": list(SCRIPTED_AGENTS),
                "experiments": examples,
            },
        )
