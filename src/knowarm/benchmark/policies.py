"""Policies of a benchmark: run folders, exported folders, anything with ``reset`` and ``act``."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from knowarm.benchmark.external import ExportedPolicy, OnnxPolicy, PredictingPolicy
from knowarm.benchmark.suites import Cell
from knowarm.config import to_dict
from knowarm.errors import UserError, packages_of
from knowarm.experiment.evaluate import known_in_test
from knowarm.experiment.evaluation import Places, Subject, told_places
from knowarm.experiment.knows import NoKnowledge, answers_by_graph
from knowarm.experiment.load import load_agent
from knowarm.experiment.other_graphs import check_graph
from knowarm.experiment.run_inputs import input_content
from knowarm.experiment.zoo import POLICIES, shipped_name
from knowarm.learn.algorithms import privileged_uses
from knowarm.own import load
from knowarm.perception.solving import player
from knowarm.reading import digest, read_bytes, reading
from knowarm.world.agents import SCRIPTED_AGENTS
from knowarm.world.agents.protocol import INPUTS, AgentProtocol
from knowarm.world.agents.scripted import InformedAgent, OpenLoopAgent
from knowarm.world.config import (
    EnvConfig,
    facets_of,
    known_places,
    questions_of,
    row_names,
)
from knowarm.world.description import SUFFIX
from knowarm.world.envs.vector_env import ArmVectorEnv

MakeAgent = Callable[[Cell, ArmVectorEnv], AgentProtocol]
SEEN = "seen:"
"""Before a run folder: no policy, inverse kinematics to the frame that its network sees."""


@dataclass(frozen=True, kw_only=True)
class Entrant:
    """A policy that a benchmark can play: one training seed of a row."""

    spec: str
    """What was given: a run folder, an exported folder, ``module:Name`` or a scripted agent."""
    make: MakeAgent
    """Return an agent for a cell and its environment; a `UserError` says why it cannot play."""
    inputs: tuple[str, ...] = ("image",)
    """What it uses, of `INPUTS`."""
    training: str = ""
    """How it was trained, in a few words."""
    digest: str = ""
    """SHA-256 of all files that decide what it does and declares, where it has any."""
    controls: dict[str, MakeAgent] = field(default_factory=dict)
    """Controls that only this kind of policy has."""
    seed: int | None = None
    """Training seed."""
    num_envs: int = 100
    """Episodes played side by side."""


def entrant(spec: str) -> Entrant:
    """Find a policy.

    Raises:
        UserError: there is none of this name, or its files are damaged.
    """
    path = Path(spec)
    if spec in SCRIPTED_AGENTS:
        return _scripted(spec)
    if spec.startswith(SEEN):
        return _run(spec.removeprefix(SEEN), solves=True)
    if _is_run(spec):  # first: a folder of a stranger may hold both
        return _run(spec)
    if (path / "contract.json").is_file():
        return _exported(spec, path)
    if path.is_dir() or shipped_name(spec):
        return _run(spec)
    if path.suffix == ".onnx":
        return _entrant(spec, OnnxPolicy(path))
    if spec.startswith(("ws://", "wss://")):
        from knowarm.deploy.client import Client

        return _entrant(spec, Client(spec))
    if ":" in spec:
        return _entrant(spec, _user_policy(spec))
    raise UserError(
        f"There is no policy {spec!r}. Give a run folder, {SEEN}RUN, a folder of `knowarm export`, "
        "an ONNX file, ws://HOST:PORT, package.module:Name, package.module:Name:FILE, or one of "
        f"{', '.join(SCRIPTED_AGENTS)}."
    )


def is_safe(spec: str) -> bool:
    """Return whether what plays is a scripted agent or a run folder, which strangers may give."""
    folder = spec.removeprefix(SEEN)
    is_remote = ":" in folder or folder.startswith(("//", "\\\\"))
    with suppress(OSError):  # a name that no file can have
        return spec in SCRIPTED_AGENTS or (not is_remote and _is_run(folder))
    return False


def _is_run(folder: str) -> bool:
    file = Path(folder) / "config.json"
    return file.is_file() or shipped_name(folder) in POLICIES


def _scripted(name: str) -> Entrant:
    agent = SCRIPTED_AGENTS[name]

    def make(cell: Cell, env: ArmVectorEnv) -> AgentProtocol:
        if agent.kind is OpenLoopAgent:
            return OpenLoopAgent(cell.open_loop)
        return agent.make(env, 0)

    return Entrant(spec=name, make=make, inputs=agent.kind.inputs, training="scripted")


def _run(spec: str, *, solves: bool = False) -> Entrant:
    """Return a run's agent; with ``solves`` what its network sees is solved, without its policy."""
    trained = load_agent(spec)
    config = trained.config
    folder = trained.folder
    solves = solves or config.solves

    def make(
        cell: Cell,
        env: ArmVectorEnv,
        reasoning: Any = None,
        places: Places = "graph",
    ) -> AgentProtocol:
        learned = config.env
        played = cell.env
        has_task = learned.task.name == played.task.name
        if solves:  # whatever has to be done with what the network sees
            has_task = learned.task.asked.kind == played.task.asked.kind
        if not has_task or not _same_robot(learned, played):
            raise UserError(
                f"{spec} was trained for {Path(learned.robot).stem} and {learned.task.name}."
            )
        if facets_of(learned) != facets_of(played):
            raise UserError(f"{spec} was trained with other objects or colours.")
        graph = cell.graph or played.task.asked.edited_graph(facets_of(played))
        if graph is not None:
            check_graph(config, played)
        subject = Subject(env=played, config=config, graph=graph, reasoning=reasoning)
        informed = known_in_test(trained, subject)
        known = told_places(graph or known_places(played), places, config.seed)
        hears = places != "unknown"
        return player(informed, played, known, solves=solves, hears=hears)

    uses = {
        "image": True,
        "words": questions_of(config.env) is not None and trained.network is not None,
        "graph": not isinstance(config.knows, NoKnowledge),
        "simulator": solves or config.role == "privileged",
    }
    training = f"{config.name}, {folder.steps_trained:,} steps"
    privileged = privileged_uses(to_dict(config.algorithm))
    if privileged:
        training += f"; training used the simulator's state for {', '.join(privileged)}"
    if solves:
        training = f"network of {training}; joint angles and kinematic model are known"
    controls: dict[str, MakeAgent] = {}
    if answers_by_graph(config.knows):
        shuffled = partial(make, reasoning="graph-shuffled")
        controls["shuffled graph"] = shuffled
        if config.env.task.skill.tells_facts:
            controls["shuffled places"] = partial(make, places="shuffled")
            controls["shuffled both"] = partial(shuffled, places="shuffled")
            controls["unknown places"] = partial(make, places="unknown")
    return Entrant(
        spec=f"{SEEN}{spec}" if solves else spec,
        make=make,
        inputs=tuple(filter(uses.get, INPUTS)),
        training=training,
        digest=folder.digest,
        controls=controls,
        seed=config.seed,
    )


def _same_robot(first: EnvConfig, second: EnvConfig) -> bool:
    """Return whether the robots of two tasks are one, or two copies of one's own."""
    names = (first.robot, second.robot)
    if not all(name.endswith(SUFFIX) for name in names):
        return first.robot == second.robot
    return input_content(first.robot) == input_content(second.robot)


def _exported(spec: str, folder: Path) -> Entrant:
    with (
        reading(folder, "Export the policy again."),
        packages_of("onnx", "An exported folder"),
    ):
        contract_digest = digest(read_bytes(folder / "contract.json"))
        import onnxruntime  # noqa: F401

        policy = ExportedPolicy(folder)
    has_words = len(policy.rows) > 1

    def make(cell: Cell, env: ArmVectorEnv) -> AgentProtocol:
        asked = row_names(env.config)
        if has_words and set(asked).difference(policy.rows):
            raise UserError(
                f"{spec} knows other facets or queries than those of {cell.name}."
            )
        if policy.joint_names != tuple(env.scene.joint_names):
            joints = ", ".join(policy.joint_names)
            raise UserError(
                f"{spec} moves the joints {joints}, and {cell.name} has others."
            )
        return policy

    return Entrant(
        spec=spec,
        make=make,
        inputs=("image", "words") if has_words else ("image",),
        training="exported",
        digest=contract_digest,
    )


def _user_policy(spec: str) -> Any:
    """Make what ``module:Name`` names, or load a file with its ``load``: ``module:Name:FILE``."""
    module, name, *file = spec.split(":", 2)
    needed = "a class with the methods reset and act"
    policy = load(f"{module}:{name}", "policy", lambda value: value is not None, needed)
    try:
        if file:
            policy = policy.load(file[0])
        elif callable(policy):
            policy = policy()
    except (AttributeError, OSError, TypeError, ValueError) as error:
        raise UserError(f"Cannot make the policy {spec!r}: {error}.") from None
    if hasattr(policy, "predict"):
        return PredictingPolicy(policy)
    return policy


def _entrant(spec: str, policy: Any) -> Entrant:
    for method in ("reset", "act"):
        if not callable(getattr(policy, method, None)):
            raise UserError(
                f"{spec} has no method {method}(); a policy has reset and act."
            )
    inputs = tuple(getattr(policy, "inputs", ("image",)))
    if unknown := set(inputs) - set(INPUTS):
        raise UserError(
            f"{spec}.inputs names {', '.join(unknown)}; allowed: {', '.join(INPUTS)}."
        )
    return Entrant(
        spec=spec,
        make=lambda cell, env: InformedAgent(
            policy, partial(replace, graph=cell.graph)
        ),
        inputs=inputs,
        training=str(getattr(policy, "training", "")),
        digest=getattr(policy, "digest", ""),
        seed=getattr(policy, "seed", None),
        num_envs=getattr(policy, "num_envs", Entrant.num_envs),
    )
