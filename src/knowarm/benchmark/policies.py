"""Policies of a benchmark: run folders, exported folders, anything with ``reset`` and ``act``."""

import copy
import hashlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from knowarm.benchmark.external import OnnxPolicy, PredictingPolicy
from knowarm.benchmark.suites import Cell
from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.experiment.conditions import Subject
from knowarm.experiment.evaluate import known_in_test
from knowarm.experiment.load import load_agent
from knowarm.experiment.other_graphs import check_graph, splits_of
from knowarm.integrations.runner import Runner
from knowarm.knowledge import KnowledgeGraph
from knowarm.learn.algorithms import privileged_uses
from knowarm.own import load
from knowarm.reading import reading
from knowarm.world.agents import SCRIPTED_AGENTS, AgentProtocol
from knowarm.world.agents.open_loop import FixedList
from knowarm.world.config import facets_of, questions_of
from knowarm.world.envs.running import joint_increments
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.state import ACTION_LEVELS

INPUTS = ("image", "words", "graph", "simulator")
"""What a policy may use: the image, the query's words, a graph, the simulator's state."""


@dataclass(frozen=True, kw_only=True)
class Batch:
    """What a policy receives when n episodes start; the simulator's state is not part of it."""

    size: int
    """Number of episodes n, which are played side by side."""
    joints: Mapping[str, NDArray[np.float64]]
    """Start angle of each joint by name, (n,) [rad] (slides: [m])."""
    increments: NDArray[np.float64]
    """Joint increment of each of the seven levels, (7,) [rad]."""
    limits: NDArray[np.float64]
    """Lower and upper limits of the joints, (2, J) [rad]."""
    queries: tuple[str, ...] | None = None
    """Query of each episode, such as ``usedFor drinking and hasColor blue``."""
    conditions: tuple[tuple[tuple[str, str], ...], ...] | None = None
    """The same as (relation, value) pairs."""
    graph: KnowledgeGraph | None = None
    """Graph that replaces the policy's own in these episodes."""


class BenchmarkPolicy(Protocol):
    """A policy of anybody."""

    def reset(self, batch: Batch) -> None:
        """Forget everything: n new episodes start."""

    def act(self, observations: Mapping[str, NDArray[Any]]) -> NDArray[np.int64]:
        """Choose actions (n, J), levels 0 to 6 of each joint.

        ``observations["image"]`` is (n, 64, 64, 3) uint8 RGB, ``observations["joint_targets"]``
        the joint angles that the actions have commanded, (n, J) float32 [rad].
        """


class PolicyAdapter:
    """Plays a `BenchmarkPolicy` as an agent, and checks its actions."""

    def __init__(self, policy: BenchmarkPolicy, graph: KnowledgeGraph | None = None) -> None:
        self._policy, self._graph = policy, graph

    def start(self, env: ArmVectorEnv) -> None:
        """Hand the policy the start of the episodes."""
        self._env, scene = env, env.scene
        table = questions_of(env.config)
        asked = [] if table is None else [table.queries[row] for row in env.knowledge_input]
        names = scene.joint_names
        self._shape = (env.num_envs, len(names))
        batch = Batch(
            size=env.num_envs,
            joints=dict(zip(names, env.joint_positions.T.copy(), strict=True)),
            increments=joint_increments(scene.robot, env.config),
            limits=np.stack([scene.joint_lower, scene.joint_upper]),
            queries=tuple(query.name for query in asked) or None,
            conditions=tuple(tuple((c.relation, c.value) for c in q.conditions) for q in asked)
            or None,
            graph=self._graph,
        )
        self._policy.reset(batch)

    def act(self, observations: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Return the policy's actions (n, J).

        Raises:
            UserError: they are no integers of this shape from 0 to 6.
        """
        seen: dict[str, NDArray[Any]] = {"image": observations}
        seen["joint_targets"] = self._env.joint_targets.astype(np.float32)
        actions = np.asarray(self._policy.act(seen))
        levels = len(ACTION_LEVELS)
        if (
            actions.shape != self._shape
            or not np.issubdtype(actions.dtype, np.integer)
            or not ((actions >= 0) & (actions < levels)).all()
        ):
            found = f"{actions.dtype} of shape {actions.shape}"
            raise UserError(
                f"act() must return integers 0 to {levels - 1} of shape {self._shape}, one row per "
                f"episode and one column per joint; got {found}."
            )
        return actions.astype(np.int64)


class ShuffledQueries:
    """Plays an agent with the queries of other episodes of the batch."""

    def __init__(self, agent: AgentProtocol) -> None:
        self._agent = agent

    def start(self, env: Any) -> None:
        """Start the agent in an environment whose queries are permuted."""
        rows = np.asarray(env.knowledge_input)
        order = np.random.default_rng(0).permutation(len(rows))
        asking: Any = _Asking(env, rows[order])
        self._agent.start(asking)

    def act(self, observations: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Return the agent's actions (n, J)."""
        return self._agent.act(observations)


class _Asking:
    """An environment with other queries."""

    def __init__(self, env: Any, knowledge_input: NDArray[np.int64]) -> None:
        self._env = env
        self.knowledge_input = knowledge_input

    def __getattr__(self, name: str) -> Any:
        return getattr(self._env, name)


@dataclass(frozen=True, kw_only=True)
class Entrant:
    """A policy that a benchmark can play: one training seed of a row."""

    spec: str
    """What was given: a run folder, an exported folder, ``module:Name`` or a scripted agent."""
    make: Callable[[Cell], AgentProtocol]
    """Return an agent for a cell, or raise a `UserError` that says why it cannot play it."""
    inputs: tuple[str, ...] = ("image",)
    """What it uses, of `INPUTS`."""
    training: str = ""
    """How it was trained, in a few words."""
    digest: str = ""
    """SHA-256 of its files, where it has any."""
    controls: dict[str, Callable[[Cell], AgentProtocol]] = field(default_factory=dict)
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
    if (path / "contract.json").is_file():
        return _exported(spec, path)
    if path.is_dir():
        return _run(spec)
    if path.suffix == ".onnx":
        return _entrant(spec, OnnxPolicy(path))
    if spec.startswith(("ws://", "wss://")):
        from knowarm.integrations.serve import MOST_CONNECTIONS, Client

        policy = _Runners(lambda: Client(spec), ("image", "words"), "served")
        return _entrant(spec, policy, MOST_CONNECTIONS)
    if ":" in spec:
        return _entrant(spec, _user_policy(spec))
    raise UserError(
        f"There is no policy {spec!r}. Give a run folder, a folder of `knowarm export`, an ONNX "
        "file, ws://HOST:PORT, package.module:Name, package.module:Name:FILE, or one of "
        f"{', '.join(SCRIPTED_AGENTS)}."
    )


def _scripted(name: str) -> Entrant:
    inputs = ("simulator",) if name == "oracle" else ()

    def make(cell: Cell) -> AgentProtocol:
        return FixedList(cell.open_loop) if name == "open-loop" else SCRIPTED_AGENTS[name].make(0)

    return Entrant(spec=name, make=make, inputs=inputs, training="scripted")


def _run(spec: str) -> Entrant:
    trained = load_agent(spec)
    config = trained.config

    def make(cell: Cell, reasoning: Any = None) -> AgentProtocol:
        own, other = config.env, cell.env
        if (own.robot, own.task.kind_of()) != (other.robot, other.task.kind_of()):
            raise UserError(f"{spec} was trained for {own.robot} and {own.task.kind_of()}.")
        if facets_of(own) != facets_of(other):
            raise UserError(f"{spec} was trained with other objects or colours.")
        # A fresh copy: knowledge of one cell must not stay for the next.
        graph = cell.graph or (splits_of(other).edited if cell.split == "S5" else None)
        if graph is not None:
            check_graph(config, other)
        fresh = load_agent(spec)
        subject = Subject(env=other, config=fresh.config, graph=graph, reasoning=reasoning)
        agent, table = known_in_test(fresh, subject)
        if table is not None:
            fresh.set_knowledge_table(table)
        return agent

    asks = questions_of(config.env) is not None and trained.network is not None
    uses = {
        "image": True,
        "words": asks,
        "graph": config.knowledge.detail != "none",
        "simulator": config.role == "privileged",
    }
    privileged = privileged_uses(to_dict(config.algorithm))
    training = f"{config.name}, {trained.folder.steps_trained:,} steps"
    if privileged:
        training += f"; training used the simulator's state for {', '.join(privileged)}"
    controls = {}
    if config.reasoning == "graph":
        controls["shuffled graph"] = lambda cell: make(cell, "graph-shuffled")
    files = sorted((trained.folder.checkpoints / "best").glob("*.safetensors"))
    perception = trained.folder.path / "perception.safetensors"
    parts = [path.read_bytes() for path in (*files, perception) if path.is_file()]
    return Entrant(
        spec=spec,
        make=make,
        inputs=tuple(name for name in INPUTS if uses[name]),
        training=training,
        digest=hashlib.sha256(b"".join(parts)).hexdigest(),
        controls=controls,
        seed=config.seed,
    )


class _Runners:
    """Plays what commands joint targets, one runner or client per episode."""

    def __init__(self, make: Callable[[], Any], inputs: tuple[str, ...], training: str) -> None:
        self._make, self.inputs, self.training = make, inputs, training
        self._runners = [make()]

    def reset(self, batch: Batch) -> None:
        """Start a runner per episode."""
        while len(self._runners) < batch.size:
            self._runners.append(self._make())
        for i in range(batch.size):
            joints = {name: float(angles[i]) for name, angles in batch.joints.items()}
            row = None if batch.queries is None else batch.queries[i]
            self._runners[i].start(joints, row)
        self._batch = batch

    def act(self, observations: Mapping[str, NDArray[Any]]) -> NDArray[np.int64]:
        """Step every runner; return the levels that lead nearest to its joint targets."""
        images, joints = observations["image"], observations["joint_targets"].astype(np.float64)
        wanted = np.empty_like(joints)
        for i, image in enumerate(images):
            self._runners[i].targets = joints[i]
            wanted[i] = self._runners[i].step(image)
        reached = joints[..., None] + self._batch.increments
        reached = reached.clip(*self._batch.limits[..., None])
        return np.abs(reached - wanted[..., None]).argmin(-1)


def _exported(spec: str, folder: Path) -> Entrant:
    if find_spec("onnxruntime") is None:
        raise UserError("An exported folder needs pip install 'knowarm[onnx]'.")
    with reading(folder, "Export the policy again."):
        data = (folder / "contract.json").read_bytes()
        contract = json.loads(data)
        rows, names = contract["knowledge"]["rows"], set(contract["joints"]["names"])
        loaded = Runner.load(folder)
    inputs = ("image", "words") if len(rows) > 1 else ("image",)
    policy = _Runners(lambda: copy.copy(loaded), inputs, "exported")  # which share the models

    def make(cell: Cell) -> AgentProtocol:
        table = questions_of(cell.env)
        asked = {query.name for query in table.queries} if table is not None else set[str]()
        if not asked <= set(rows) or (not asked and len(rows) > 1):
            raise UserError(f"{spec} knows other queries than those of {cell.name}.")
        if not names <= set(ArmVectorEnv(cell.env, 1).scene.robot.joints):
            raise UserError(f"{spec} moves the joints {', '.join(sorted(names))}.")
        return PolicyAdapter(policy, cell.graph)

    return replace(_entrant(spec, policy), make=make, digest=hashlib.sha256(data).hexdigest())


def _user_policy(spec: str) -> Any:
    """Make what ``module:Name`` names, or load a file with its ``load``: ``module:Name:FILE``."""
    module, name, *file = spec.split(":", 2)
    needed = "a class with the methods reset and act"
    made = load(f"{module}:{name}", "policy", lambda each: each is not None, needed)
    try:
        policy = made.load(file[0]) if file else made() if callable(made) else made
    except (AttributeError, OSError, TypeError, ValueError) as error:
        raise UserError(f"Cannot make the policy {spec!r}: {error}.") from None
    return PredictingPolicy(policy) if hasattr(policy, "predict") else policy


def _entrant(spec: str, policy: Any, num_envs: int = 100) -> Entrant:
    for method in ("reset", "act"):
        if not callable(getattr(policy, method, None)):
            raise UserError(f"{spec} has no method {method}(); a policy has reset and act.")
    inputs = tuple(getattr(policy, "inputs", ("image",)))
    if unknown := set(inputs) - set(INPUTS):
        raise UserError(f"{spec}.inputs names {', '.join(unknown)}; allowed: {', '.join(INPUTS)}.")
    return Entrant(
        spec=spec,
        make=lambda cell: PolicyAdapter(policy, cell.graph),
        inputs=inputs,
        training=str(getattr(policy, "training", "")),
        digest=getattr(policy, "digest", ""),
        seed=getattr(policy, "seed", None),
        num_envs=num_envs,
    )
