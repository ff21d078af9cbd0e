"""``knowarm list``: robots, targets, agents, algorithms and experiments."""

from dataclasses import dataclass
from typing import Annotated, Any

from tyro.conf import Positional, arg

from knowarm.cli.tables import TableCommand, Values, print_table
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

FIRST = 5  # names of each kind that are shown if none is given


def _print_kinds() -> None:
    names_by_kind = {
        "robots": [*ROBOTS, *KNOWN_ARMS],
        "agents": list(AGENTS),
        "algorithms": list(algorithms()),
        "targets": list(TARGETS),
    }
    rows: list[list[Any]] = []
    for kind, names in names_by_kind.items():
        rows.append(
            [kind, len(names), ", ".join(names[:FIRST]), f"knowarm list {kind}"]
        )
    print_table("Names", ["kind", "number", "the first", "for all"], rows)


def _print_robots() -> None:
    rows = []
    for name, robot in ROBOTS.items():
        ids = [env_id(name, task) for task in task_names()]
        rows.append([name, robot.title, ", ".join(ids)])
    print_table("Robots", ["robot", "name", "Gymnasium ids"], rows)
    rows = []
    for arm in map(find_robot, KNOWN_ARMS):
        file = str(arm.mjcf) if arm.mjcf.is_file() else "missing"
        rows.append([arm.name, arm.title, file])
    title = "Known arms, whose files are in the MuJoCo Menagerie"
    print_table(title, ["robot", "name", "file"], rows)
    if any(file == "missing" for *_, file in rows):
        print(f"To get the missing files: {HOW_TO_GET}.\n")


def _print_agents() -> None:
    rows = []
    for name, agent in AGENTS.items():
        about = agent.about
        if agent.knows.grounding is not None:
            about += "; grounded by the simulator's labels in training"
        rows.append([name, agent.role, about])
    print_table("Agents", ["agent", "role", "description"], rows)
    title = "Scripted agents, for `knowarm evaluate` and `knowarm view`"
    scripted = [[name, agent.about] for name, agent in SCRIPTED_AGENTS.items()]
    print_table(title, ["agent", "description"], scripted)


def _print_algorithms() -> None:
    rows: list[list[Any]] = []
    for name, algorithm in algorithms().items():
        uses = ", ".join(privileged_uses(to_dict(algorithm.config)))
        rows.append([name, algorithm.total_steps, uses, algorithm.about])
    columns = ["algorithm", "steps", "simulator's state in training", "description"]
    print_table("Algorithms", columns, rows)


def _print_targets() -> None:
    names_by_colours: dict[str, list[str]] = {}
    for name, target in TARGETS.items():
        names_by_colours.setdefault(", ".join(target.colours), []).append(name)
    rows = [[", ".join(names), colours] for colours, names in names_by_colours.items()]
    print_table("Targets", ["targets", "colours, the fixed one first"], rows)


def _print_experiments() -> None:
    print(
        "An experiment is named ROBOT-AGENT-ALGORITHM, with -dr after the agent for\n"
        "randomized colours, and with the task after the robot if it is not reach. A\n"
        "robot of your own is an option, and the experiment is named after its file:\n"
        f"  knowarm train {DEFAULT_EXPERIMENT}\n"
        "  knowarm train full-fast --env.robot my_arm.toml\n"
        "  knowarm train tiago-bm-dr-ppo\n"
        "  knowarm train irb120-choose-answers-distil"
    )


KINDS = {
    "robots": _print_robots,
    "agents": _print_agents,
    "algorithms": _print_algorithms,
    "targets": _print_targets,
    "experiments": _print_experiments,
}
"""What prints the names of each kind."""


@dataclass(frozen=True, kw_only=True)
class List(TableCommand):
    """List robots, agents, algorithms, targets and names of experiments."""

    kind: Annotated[Positional[str | None], arg(metavar="[KIND]")] = None
    """All robots, agents, algorithms or targets; without it, the first of each."""

    def result(self) -> Values:
        """Print the names of one kind, or the first of each."""
        if self.kind is None:
            _print_kinds()
            _print_experiments()
        elif self.kind in KINDS:
            KINDS[self.kind]()
        else:
            raise unknown_name("kind of names", self.kind, KINDS)
        return {
            "robots": {name: robot.title for name, robot in ROBOTS.items()},
            "known_arms": {arm.name: arm.title for arm in map(find_robot, KNOWN_ARMS)},
            "targets": {name: list(target.colours) for name, target in TARGETS.items()},
            "agents": {name: agent.about for name, agent in AGENTS.items()},
            "roles": {name: agent.role for name, agent in AGENTS.items()},
            "algorithms": list(algorithms()),
            "scripted_agents": list(SCRIPTED_AGENTS),
            "experiments": experiment_names(),
        }
