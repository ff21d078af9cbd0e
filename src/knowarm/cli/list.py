"""``knowarm list``: robots, targets, agents, algorithms and experiments."""

from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args

import tyro

from knowarm.cli.tables import TableCommand, print_table
from knowarm.config import to_dict
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

Kind = Literal["robots", "agents", "algorithms", "targets", "experiments"]


@dataclass(frozen=True, kw_only=True)
class List(TableCommand):
    """List robots, agents, algorithms, targets and names of experiments."""

    kind: Annotated[Kind | None, tyro.conf.Positional, tyro.conf.arg(metavar="[KIND]")] = None
    """Only robots, agents, algorithms, targets or experiments."""

    def result(self) -> dict[str, Any]:
        """Print one table per kind."""
        arms = [find_robot(name) for name in KNOWN_ARMS]
        kinds = [self.kind] if self.kind else get_args(Kind)
        if "robots" in kinds:
            rows: list[list[Any]] = [
                [name, entry.title, ", ".join(env_id(name, task) for task in task_names())]
                for name, entry in ROBOTS.items()
            ]
            print_table("Robots", ["robot", "name", "Gymnasium ids"], rows)
            files = [str(arm.mjcf) if arm.mjcf.is_file() else "missing" for arm in arms]
            rows = [[arm.name, arm.title, file] for arm, file in zip(arms, files, strict=True)]
            title = "Known arms, whose files are in the MuJoCo Menagerie"
            print_table(title, ["robot", "name", "file"], rows)
            if "missing" in files:
                print(f"To get the missing files: {HOW_TO_GET}.\n")
        if "agents" in kinds:
            grounded = "; grounded by the simulator's labels in training"
            rows = [
                [name, agent.role, agent.about + grounded * agent.knows.is_grounded]
                for name, agent in AGENTS.items()
            ]
            print_table("Agents", ["agent", "role", "description"], rows)
            rows = [[name, agent.about] for name, agent in SCRIPTED_AGENTS.items()]
            title = "Scripted agents, for `knowarm evaluate` and `knowarm view`"
            print_table(title, ["agent", "description"], rows)
        if "algorithms" in kinds:
            rows = [
                [
                    name,
                    each.total_steps,
                    ", ".join(privileged_uses(to_dict(each.config))),
                    each.about,
                ]
                for name, each in algorithms().items()
            ]
            columns = ["algorithm", "steps", "simulator's state in training", "description"]
            print_table("Algorithms", columns, rows)
        if "targets" in kinds:
            alike: dict[str, list[str]] = {}
            for name, target in TARGETS.items():
                alike.setdefault(", ".join(target.colours), []).append(name)
            rows = [[", ".join(names), colours] for colours, names in alike.items()]
            print_table("Targets", ["targets", "colours, the fixed one first"], rows)
        if "experiments" in kinds:
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
