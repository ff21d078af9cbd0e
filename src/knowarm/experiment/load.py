"""Trained agents, loaded from their run folders."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch

from knowarm.config import from_dict
from knowarm.errors import UserError
from knowarm.experiment.config import ExperimentConfig, Which
from knowarm.experiment.hub import pull_from_hub
from knowarm.experiment.knows import Knowledge, NoKnowledge
from knowarm.experiment.other_graphs import check_graph, with_graph
from knowarm.experiment.run_folder import RunFolder, given_network, stored_network
from knowarm.experiment.zoo import open_run
from knowarm.knowledge import KnowledgeGraph
from knowarm.learn import read_checkpoint
from knowarm.learn.checkpoint import to_tensors
from knowarm.perception.calibration import calibrated_thresholds
from knowarm.perception.config import shown_in
from knowarm.perception.grounding import GroundingNetwork
from knowarm.perception.recognition import AnswerGrounding, AnsweringAgent
from knowarm.perception.solving import SeeingAgent, player
from knowarm.policy import Policy, PolicyAgent, PolicyConfig, PolicyShape
from knowarm.questions import find_rows
from knowarm.reading import one_line, reading
from knowarm.world.agents.protocol import Batch
from knowarm.world.config import EnvConfig, known_places, questions_of, row_names

log = logging.getLogger("knowarm.experiment")


@dataclass
class TrainedAgent:
    """A trained agent and its origin."""

    agent: PolicyAgent  #: Recognizes, and chooses actions by the policy where `player` is it.
    policy: Policy  #: The network, in evaluation mode.
    table: np.ndarray  #: (rows, K) float32, the knowledge table of its training.
    network: GroundingNetwork | None  #: Its trained grounding network, if it has one.
    #: What it was trained with; with another ``graph``, that graph and its questions.
    config: ExperimentConfig
    folder: RunFolder  #: The run.
    step: int  #: Environment steps it was trained for.
    which: (
        Which  #: Checkpoint: of the best interim evaluation, the latest, or untrained.
    )
    training: EnvConfig  #: The environment that it was trained in.
    # New objects that were reported, and whether new questions were
    _reported: set[str] = field(default_factory=set, init=False)
    _reported_questions: bool = field(default=False, init=False)
    # Whether the next step is the first
    _is_new: bool | None = field(default=None, init=False)
    # What is known of the episodes that started, fields of a `Batch`
    _start: dict[str, Any] = field(default_factory=dict, init=False)

    def reset(self, batch: Batch | Mapping[str, Any]) -> None:
        """Forget everything: episodes start, one or several side by side.

        Objects and questions that training never showed or asked are logged as warnings, once.

        Args:
            batch: infos of an environment's reset, from which an agent whose knowledge depends
                on the episode takes the name of its facet or query; or what `play` hands over.

        Raises:
            UserError: the infos lack the facet or query, or the agent does not know it.
        """
        self._is_new = True
        self._start = {}
        if isinstance(batch, Batch):
            self._start = {"joints": batch.joints, "facts": batch.facts}
        if self.agent.depends_on_rows:
            self._start["names"] = self._known_names(batch)
        self._report_new(batch)

    def _known_names(self, batch: Batch | Mapping[str, Any]) -> np.ndarray:
        """Return the facet or query of each episode, which the agent knows."""
        info = self.config.env.task.asked.knowledge_info
        infos = {info: batch.names} if isinstance(batch, Batch) else batch
        if info not in infos:
            raise UserError(
                f"The knowledge of this agent depends on the info {info!r} of the episode: pass "
                "the infos of the environment's reset, agent.reset(info)."
            )
        names = np.array(_texts(infos, info), np.str_)
        known = dict.fromkeys(row_names(self.config.env), 0)
        find_rows(f"{info} of {self.config.name}", names, known)
        return names

    def act(self, observations: np.ndarray | Mapping[str, np.ndarray]) -> np.ndarray:
        """Choose the action of a step in any environment, also one of ``gymnasium.make``.

        Args:
            observations: image (H, W, 3) uint8, or images (n, H, W, 3) of n environments, whose
                episodes started together; alone, or as ``image`` of a dictionary.

        Returns:
            Action (J,) or (n, J) int64.

        Raises:
            UserError: no episodes have started, or another number; the image is another one.
        """
        if not isinstance(observations, Mapping):
            observations = {"image": observations}
        image = np.asarray(observations["image"])
        images = image.reshape(-1, *image.shape[-3:])
        if self._is_new:
            env = self.config.env
            names = np.repeat(row_names(env)[:1], len(images))
            self.player.reset(Batch(**{"env": env, "names": names, **self._start}))
            self._is_new = False
        started = 0 if self._is_new is None else len(self.agent.rows)
        if len(images) != started:
            raise UserError(
                f"{started} episodes have started, and there are {len(images)} images: call "
                "reset(info) whenever environments are reset."
            )
        actions = self.player.act({**observations, "image": images})
        return actions.reshape(*image.shape[:-3], -1)

    @cached_property
    def player(self) -> PolicyAgent | SeeingAgent:
        """What acts: the agent with its policy, or inverse kinematics in its place."""
        return self.acting(self.agent)

    def acting(
        self,
        agent: PolicyAgent,
        graph: KnowledgeGraph | None = None,
        *,
        guesses: bool = True,
    ) -> PolicyAgent | SeeingAgent:
        """Return what acts for an agent.

        ``graph`` says where objects belong, None: its own; ``guesses`` as in `SeeingAgent`.
        """
        env = self.config.env
        if graph is None:
            graph = known_places(env)
        solves = self.config.solves
        return player(agent, env, graph, solves=solves, guesses=guesses)

    def _report_new(self, batch: Batch | Mapping[str, Any]) -> None:
        """Log objects that training never showed, once each; and once, questions of the kind."""
        if isinstance(batch, Batch):
            facets = ["/".join(facet) for facet in shown_in(batch.env)]
            questions = list(batch.queries or ())
        else:
            facets = _texts(batch, "facet")
            questions = _texts(batch, "query")
        shown, asked = self._trained_on
        seen = {facet.partition("/")[0] for facet in shown}
        objects = set()
        for facet in facets:
            name, _, colour = facet.partition("/")
            if facet not in shown:
                objects.add(f"{colour} {name}" if name in seen else name)
        self._report("showed", objects - self._reported)
        self._reported |= objects
        if not self._reported_questions:
            unasked = set(questions) - asked
            self._report("asked", unasked)
            self._reported_questions = bool(unasked)

    def _report(self, did: str, new: set[str]) -> None:
        if new:
            log.warning(
                "%s meets what its training never %s: %s. Its scores there say how it generalizes; "
                "make the environment with trained.training to play what it was trained on.",
                self.config.name,
                did,
                "; ".join(sorted(new)),
            )

    @cached_property
    def _trained_on(self) -> tuple[set[str], set[str]]:
        """Facets that training showed, and questions that it asked."""
        shown = {"/".join(facet) for facet in shown_in(self.training)}
        table = questions_of(self.training)
        if table is None:
            return shown, set()
        asked = np.flatnonzero(table.askable.any(axis=1))
        return shown, {table.queries[row].name for row in asked}

    def thresholds(self, level: float) -> torch.Tensor:
        """Return the likelihoods from which its network takes objects for answers, by facet."""
        assert self.network is not None
        return calibrated_thresholds(
            self.network, self.config.env, level, self.config.seed
        )

    def with_knowledge(self, knowledge: Knowledge, **options: Any) -> PolicyAgent:
        """Return an agent with this policy and other knowledge; options as its class."""
        return knowledge.make_agent(self.policy, **self._actions, **options)

    def answering(self, answers: np.ndarray, **options: Any) -> AnsweringAgent:
        """Return an agent with this policy and network that answers queries by (Q, F) answers.

        Those tell whether each facet of the network answers each query. Options as
        `AnsweringAgent`.
        """
        assert self.network is not None
        recognition = AnswerGrounding(self.network, answers)
        return AnsweringAgent(self.policy, recognition, **self._actions, **options)

    @property
    def _actions(self) -> dict[str, Any]:
        """How the agent chooses its actions."""
        return {"greedy": self.agent.greedy, "generator": self.agent.generator}


def load_agent(
    path: Path | str,
    *,
    which: Which = "best",
    greedy: bool = True,
    seed: int = 0,
    perception: Path | str | None = None,
    graph: KnowledgeGraph | Path | str | None = None,
) -> TrainedAgent:
    """Load the trained agent of a run.

    Args:
        path: the run folder, e.g. ``runs/irb120-full-fast/0``, or ``zoo/NAME``, a shipped policy.
        which: the policy of the best interim evaluation, the latest, or the initial weights.
        greedy: take the most probable action instead of sampling one.
        seed: seed of the sampled actions.
        perception: file of another grounding network than the one that the run folder keeps.
        graph: what it knows in place of the graph of its training, in tasks with queries: a graph,
            its path, or the name of a shipped one. It answers all that this graph can be asked.

    Raises:
        UserError: the folder holds no run, no such checkpoint, or a damaged one; the agent knows no
            graph, or the given one describes too few objects.
    """
    folder = open_run(path)
    config = folder.experiment()
    stored = folder.provenance().policy
    checkpoint = None
    if which != "untrained":
        checkpoint = read_checkpoint(folder.checkpoints / which)
    with reading(folder.provenance_path, "Restore the file."):
        choices = from_dict(PolicyConfig, stored["config"], where="policy.config")
        shape = from_dict(PolicyShape, stored["shape"], where="policy.shape")
        policy = Policy(choices, shape, seed=config.seed)
    step = 0
    if checkpoint:
        step = int(checkpoint.facts["step"])
        try:
            policy.load_state_dict(to_tensors(checkpoint.policy))
        except RuntimeError as error:  # names or shapes differ
            raise UserError(
                f"The checkpoint {folder.checkpoints / which} does not fit the policy of its run "
                f"folder: {one_line(error)}. One of the two was replaced: restore it."
            ) from error
    if which == "best" and step == 0:
        latest_step = folder.checkpoint_fact("step", 0)
        log.warning(
            "%s: this network is untrained, since the best interim evaluation is that of step 0. "
            "The checkpoint 'latest' was trained for %s steps.",
            folder.path,
            f"{latest_step:,}",
        )
    policy.eval()
    network = None
    if perception is not None:
        network = given_network(config, perception)
    elif config.knows.grounding is not None:
        network = stored_network(config, folder)
    training = config.env
    sources: dict[str, Any] = {"table": folder.knowledge()}
    if graph is not None:
        config = _knowing(config, graph)
        sources = {}
    knowledge = config.knows.known(config.env, config.seed, network=network, **sources)
    generator = torch.Generator().manual_seed(seed)
    agent = knowledge.make_agent(policy, greedy=greedy, generator=generator)
    return TrainedAgent(
        agent,
        policy,
        knowledge.table,
        network,
        config,
        folder,
        step,
        which,
        training,
    )


def _texts(infos: Mapping[str, Any], name: str) -> list[str]:
    """Return the texts of an info of n environments, or of a single one; none without it."""
    texts: list[str] = np.array(infos.get(name, ()), np.str_).reshape(-1).tolist()
    return texts


def _knowing(
    config: ExperimentConfig, graph: KnowledgeGraph | Path | str
) -> ExperimentConfig:
    """Return what an agent was trained with, with another graph and its questions."""
    if isinstance(config.knows, NoKnowledge):
        raise UserError(
            f"{config.name} knows no graph, so another one changes nothing. Leave out graph, or "
            "take a run such as zoo/irb120-choose-answers-fast."
        )
    check_graph(config, config.env)
    return with_graph(config, graph)


def from_pretrained(
    repo_id: str,
    *,
    revision: str | None = None,
    **options: Any,
) -> TrainedAgent:
    """Load a trained agent from the Hub; ``options`` are those of `load_agent`."""
    return load_agent(pull_from_hub(repo_id, revision=revision), **options)
