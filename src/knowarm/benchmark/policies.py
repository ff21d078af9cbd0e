"""Policies of a benchmark: run folders, exported folders, anything with ``reset`` and ``act``."""

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from knowarm.benchmark.suites import Cell
from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.experiment.config import EvaluationConfig
from knowarm.experiment.evaluate import agent_for_test
from knowarm.experiment.load import load_agent
from knowarm.integrations.runner import Runner
from knowarm.learn.algorithms import privileged_uses
from knowarm.world.agents import SCRIPTED_AGENTS, AgentProtocol
from knowarm.world.config import facets_of, questions_of
from knowarm.world.envs.vector_env import ReachVectorEnv
from knowarm.world.tasks.running import ACTION_LEVELS

INPUTS = ("image", "words", "graph", "simulator")
"""What a policy may use: the image, the query's words, a graph, the simulator's state."""


@dataclass(frozen=True)
class Batch:
    """What a policy receives when n episodes start; the simulator's state is not part of it."""

    size: int
    """Number of episodes n, which are played side by side."""
    joints: Mapping[str, NDArray[np.float64]]
    """Start angle of each joint by name, (n,) [rad] (slides: [m])."""
    queries: tuple[str, ...] | None = None
    """Query of each episode, such as ``usedFor drinking and hasColor blue``."""
    conditions: tuple[tuple[tuple[str, str], ...], ...] | None = None
    """The same as (relation, value) pairs."""


class BenchmarkPolicy(Protocol):
    """A policy of anybody."""

    def reset(self, batch: Batch) -> None:
        """Forget everything: n new episodes start."""

    def act(self, observations: Mapping[str, NDArray[Any]]) -> NDArray[np.int64]:
        """Choose actions (n, J), levels 0 to 6 of each joint.

        ``observations["image"]`` is (n, 64, 64, 3) uint8 RGB.
        """


class PolicyAdapter:
    """Plays a `BenchmarkPolicy` as an agent, and checks its actions."""

    def __init__(self, policy: BenchmarkPolicy) -> None:
        self._policy = policy

    def start(self, env: ReachVectorEnv) -> None:
        """Hand the policy the start of the episodes."""
        table, asked = questions_of(env.config), None
        if table is not None:
            asked = [table.queries[row] for row in np.asarray(env.knowledge_input)]
        names = env.scene.robot.joints
        self._shape = (env.num_envs, len(names))
        batch = Batch(
            size=env.num_envs,
            joints=dict(zip(names, env.joint_positions.T.copy(), strict=True)),
            queries=None if asked is None else tuple(query.name for query in asked),
            conditions=None
            if asked is None
            else tuple(tuple((c.relation, c.value) for c in query.conditions) for query in asked),
        )
        self._policy.reset(batch)

    def act(self, observations: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Return the policy's actions (n, J).

        Raises:
            UserError: they are no integers of this shape from 0 to 6.
        """
        actions = np.asarray(self._policy.act({"image": observations}))
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


class FixedList:
    """Plays a list of actions (T, J) in every episode."""

    def __init__(self, actions: NDArray[np.int64]) -> None:
        self._actions = actions

    def start(self, env: ReachVectorEnv) -> None:
        """Return to the beginning of the list."""
        self._step, self._count = 0, env.num_envs

    def act(self, observations: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Return the next actions (n, J)."""
        self._step += 1
        return np.tile(self._actions[self._step - 1], (self._count, 1))


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
    module, _, name = spec.partition(":")
    if name:
        return _user_policy(spec, module, name)
    raise UserError(
        f"There is no policy {spec!r}. Give a run folder, a folder of `knowarm export`, "
        f"package.module:Name, or one of {', '.join(SCRIPTED_AGENTS)}."
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
        agent, _ = agent_for_test(
            load_agent(spec), other, EvaluationConfig(split=cell.split, reasoning=reasoning)
        )
        return agent

    asks = questions_of(config.env) is not None and trained.network is not None
    uses = {
        "image": True,
        "words": asks,
        "graph": config.knowledge.detail != "none",
        "simulator": config.role == "privileged",
    }
    privileged = privileged_uses(to_dict(config.algorithm))
    training = f"{config.name}, {config.total_steps:,} steps"
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
    """Plays an exported policy, one runner per episode."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._runners: list[Runner] = []

    def reset(self, batch: Batch) -> None:
        """Start a runner per episode."""
        while len(self._runners) < batch.size:
            self._runners.append(Runner.load(self._folder))
        for i in range(batch.size):
            joints = {name: float(angles[i]) for name, angles in batch.joints.items()}
            row = None if batch.queries is None else batch.queries[i]
            self._runners[i].start(joints, row)
        self._count = batch.size

    def act(self, observations: Mapping[str, NDArray[Any]]) -> NDArray[np.int64]:
        """Step every runner."""
        images, runners = observations["image"], self._runners[: self._count]
        for runner, image in zip(runners, images, strict=True):
            runner.step(image)
        return np.stack([runner.levels for runner in runners]).astype(np.int64)


def _exported(spec: str, folder: Path) -> Entrant:
    contract = (folder / "contract.json").read_bytes()
    policy = _Runners(folder)
    runner = Runner.load(folder)

    def make(cell: Cell) -> AgentProtocol:
        table, rows = questions_of(cell.env), runner.contract["knowledge"]["rows"]
        names = set(runner.joint_names)
        if table is not None and not {query.name for query in table.queries} <= set(rows):
            raise UserError(f"{spec} has no vectors of the queries of {cell.name}.")
        if not names <= set(ReachVectorEnv(cell.env, 1).scene.robot.joints):
            raise UserError(f"{spec} moves the joints {', '.join(sorted(names))}.")
        return PolicyAdapter(policy)

    return Entrant(
        spec=spec, make=make, training="exported", digest=hashlib.sha256(contract).hexdigest()
    )


def _user_policy(spec: str, module: str, name: str) -> Entrant:
    try:
        made = getattr(import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise UserError(f"Cannot import the policy {spec!r}: {error}.") from None
    policy = made() if callable(made) else made
    for method in ("reset", "act"):
        if not callable(getattr(policy, method, None)):
            raise UserError(f"{spec} has no method {method}(); a policy has reset and act.")
    inputs = tuple(getattr(policy, "inputs", ("image",)))
    if unknown := set(inputs) - set(INPUTS):
        raise UserError(f"{spec}.inputs names {', '.join(unknown)}; allowed: {', '.join(INPUTS)}.")
    training = str(getattr(policy, "training", ""))
    return Entrant(
        spec=spec, make=lambda cell: PolicyAdapter(policy), inputs=inputs, training=training
    )
