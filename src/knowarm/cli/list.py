"""``knowarm list``: robots, targets, agents, algorithms and experiments."""

from dataclasses import dataclass
from typing import Annotated, Any

import tyro

from knowarm.cli.tables import TableCommand, print_table
from knowarm.config import to_dict
from knowarm.errors import unknown_name
from knowarm.experiment.agents import AGENTS
from knowarm.experiment.algorithms import algorithms
from knowarm.experiment.names import DEFAULT_EXPERIMENT, experiment_names
from knowarm.learn.algorithms import privileged_uses
from knowarm.world import env_id
from knowarm.world.agents import SCRIPTED_AGENTS
from knowarm.world.description import HOW_TO_GET
from knowarm.world.objects import TARGETS
from knowarm.world.robots import KNOWN_ARMS, ROBOTS, find_robot
from knowarm.world.tasks import task_names

KINDS = ("robots", "agents", "algorithms", "targets", "experiments")
FIRST = 5  # names of each kind that are shown if none is given


@dataclass(frozen=True, kw_only=True)
class List(TableCommand):
    """List robots, agents, algorithms, targets and names of experiments."""

    kind: Annotated[tyro.conf.Positional[str | None], tyro.conf.arg(metavar="[KIND]")] = None
    """All robots, agents, algorithms or targets; without it, the first of each."""

    def result(self) -> dict[str, Any]:
        """Print the names of one kind, or the first of each."""
        if self.kind not in (None, *KINDS):
            raise unknown_name("kind of names", self.kind, KINDS)
        arms = [find_robot(name) for name in KNOWN_ARMS]
        if self.kind is None:
            names_of_kinds = ([*ROBOTS, *KNOWN_ARMS], [*AGENTS], [*algorithms()], [*TARGETS])
            rows: list[list[Any]] = []
            for kind, names in zip(KINDS, names_of_kinds, strict=False):
                rows.append([kind, len(names), ", ".join(names[:FIRST]), f"knowarm list {kind}"])
            print_table("Names", ["kind", "number", "the first", "for all"], rows)
        if self.kind == "robots":
            rows = []
            for name, entry in ROBOTS.items():
                ids = [env_id(name, task) for task in task_names()]
                rows.append([name, entry.title, ", ".join(ids)])
            print_table("Robots", ["robot", "name", "Gymnasium ids"], rows)
            files = [str(arm.mjcf) if arm.mjcf.is_file() else "missing" for arm in arms]
            rows = [[arm.name, arm.title, file] for arm, file in zip(arms, files, strict=True)]
            title = "Known arms, whose files are in the MuJoCo Menagerie"
            print_table(title, ["robot", "name", "file"], rows)
            if "missing" in files:
                print(f"To get the missing files: {HOW_TO_GET}.\n")
        if self.kind == "agents":
            rows = []
            for name, agent in AGENTS.items():
                about = agent.about
                if agent.knows.grounding is not None:
                    about += "; grounded by the simulator's labels in training"
                rows.append([name, agent.role, about])
            print_table("Agents", ["agent", "role", "description"], rows)
            rows = [[name, agent.about] for name, agent in SCRIPTED_AGENTS.items()]
            title = "Scripted agents, for `knowarm evaluate` and `knowarm view`"
            print_table(title, ["agent", "description"], rows)
        if self.kind == "algorithms":
            rows = []
            for name, algorithm in algorithms().items():
                uses = ", ".join(privileged_uses(to_dict(algorithm.config)))
                rows.append([name, algorithm.total_steps, uses, algorithm.about])
            columns = ["algorithm", "steps", "simulator's state in training", "description"]
            print_table("Algorithms", columns, rows)
        if self.kind == "targets":
            alike: dict[str, list[str]] = {}
            for name, target in TARGETS.items():
                alike.setdefault(", ".join(target.colours), []).append(name)
            rows = [[", ".join(names), colours] for colours, names in alike.items()]
            print_table("Targets", ["targets", "colours, the fixed one first"], rows)
        if self.kind in (None, "experiments"):
            print(
                "An experiment is named ROBOT-AGENT-ALGORITHM, with -dr after the agent for\n"
                "randomized colours, and with the task after the robot if it is not reach. A\n"
                "robot of your own is an option, and the experiment is named after its file:\n"
                f"  knowarm train {DEFAULT_EXPERIMENT}\n"
                "  knowarm train full-fast --env.robot my_arm.toml\n"
                "  knowarm train tiago-bm-dr-ppo\n"
                "  knowarm train irb120-choose-answers-distil"
            )
        return {
            "robots": {name: entry.title for name, entry in ROBOTS.items()},
            "known_arms": {arm.name: arm.title for arm in arms},
            "targets": {name: list(target.colours) for name, target in TARGETS.items()},
            "agents": {name: agent.about for name, agent in AGENTS.items()},
            "roles": {name: agent.role for name, agent in AGENTS.items()},
            "algorithms": list(algorithms()),
            "scripted_agents": list(SCRIPTED_AGENTS),
            "experiments": experiment_names(),
        }
