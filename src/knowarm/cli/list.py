"""``knowarm list``: the parts experiments are made of."""

from dataclasses import dataclass
from pathlib import Path

from knowarm.cli.tables import check_json_path, print_table, write_json_table
from knowarm.experiment.agents import AGENTS
from knowarm.experiment.algorithms import ALGORITHMS
from knowarm.experiment.registry import experiment_names
from knowarm.world.objects import TARGETS
from knowarm.world.robots import ROBOTS


@dataclass(frozen=True, kw_only=True)
class List:
    """Show the robots, targets, agents, algorithms and experiments there are."""

    json: Path | None = None
    """Also write the names to this JSON file."""

    def run(self) -> None:
        """Print the tables."""
        check_json_path(self.json)
        print_table("Agents", ["agent", "what it is"], [[n, a.about] for n, a in AGENTS.items()])
        print_table(
            "Algorithms",
            ["algorithm", "steps"],
            [[name, algorithm.total_steps] for name, algorithm in ALGORITHMS.items()],
        )
        print(f"Robots: {', '.join(ROBOTS)}")
        print(f"Targets: {', '.join(TARGETS)}")
        print(
            "\nAn experiment is ROBOT-AGENT[-dr]-ALGORITHM; dr randomizes the targets' colours:\n"
            "  knowarm train irb120-full-ppo\n"
            "  knowarm train tiago-bm-dr-a3c"
        )
        write_json_table(
            self.json,
            {
                "robots": list(ROBOTS),
                "targets": list(TARGETS),
                "agents": {name: agent.about for name, agent in AGENTS.items()},
                "algorithms": list(ALGORITHMS),
                "experiments": experiment_names(),
            },
        )


COMMAND = List
