"""Recognition: what a policy knows of an episode, computed from its first image and its query.

Environments and agents with a recognition read of the simulation images and, where the task has
queries, the query; no labels.

`FrameRecognition` compares places with the vector of the query. `AnswerGrounding` takes the answers
of a graph: every place has a score per facet, its object's logit plus its colour's, and the place
whose log-sum-exp over the answering facets is largest holds the answer. A facet that answers by
doubtful facts has the logarithm of its probability added. Nothing of this is trained on queries.
"""

import copy
from collections.abc import Mapping
from typing import Any, NamedTuple, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from knowarm.errors import UserError
from knowarm.learn.checkpoint import Arrays, to_arrays
from knowarm.perception.config import Unclear, seen_width
from knowarm.perception.grounding import BATCH, GroundingNetwork, in_batches
from knowarm.perception.images import axes_of
from knowarm.policy import Policy, PolicyAgent
from knowarm.questions import SURE, number_objects, number_parts
from knowarm.world.config import EnvConfig
from knowarm.world.envs.torch_env import TorchArmVectorEnv
from knowarm.world.tasks.skills.guides import DESTINATION
from knowarm.world.tasks.state import EpisodeState


class FrameRecognition(nn.Module):
    """Recognition of grasp frames by a grounding network, which compares vectors of the queries.

    Args:
        network: the trained network.
        knowledge: (rows, D), what is known of the query of each row; one row for all episodes. None
            is the table that the network was trained with.
    """

    knowledge: Tensor

    def __init__(
        self, network: GroundingNetwork, knowledge: np.ndarray | Tensor | None = None
    ) -> None:
        super().__init__()
        self.network = network
        if knowledge is None:
            knowledge = network.knowledge
        self.register_buffer(
            "knowledge", torch.as_tensor(knowledge, dtype=torch.float32).clone()
        )

    def locate(self, images: Tensor, knowledge: Tensor) -> Tensor:
        """Find the frames (n, 9) in images (n, H, W, 3) uint8 by knowledge of queries (n, D)."""
        return cast(Tensor, self.network(images, knowledge))

    def true_frames(self, episodes: EpisodeState, ids: NDArray[np.int64]) -> Tensor:
        """Return the frames that the simulator knows of episodes (n,)."""
        axes = axes_of(episodes.goal_matrix[ids].reshape(-1, 3, 3))
        like = self.network.knowledge
        position = torch.from_numpy(episodes.goal_position[ids]).to(like)
        return self.network.standardized(position, torch.from_numpy(axes).to(like))

    def destinations(self, places: NDArray[np.float64]) -> Tensor:
        """Return the numbers of destinations at x and y (n, 2) [m], (n, 2) float32."""
        network = self.network
        position = torch.from_numpy(places).to(network.knowledge)
        return (position - network.position_mean[:2]) / network.position_std[:2]

    def place_scores(self, images: Tensor, knowledge: Tensor) -> Tensor:
        """Score the places of images (n, H, W, 3) uint8, (n, places)."""
        scores = self.network.cell_scores(
            self.network.encoder.features(images), knowledge
        )
        return scores.unflatten(1, (-1, self.network.parts)).amax(2)

    def name(self, by_place: Tensor) -> tuple[Tensor, Tensor]:
        """Name m different objects at different places, best scores (n, F, P) first, (n, m) each.

        With this network it is right more often than the m best facets of the image as a whole. All
        parts of an object are named at the best place of any.

        Returns:
            Facets and places, (n, m) int64 each.
        """
        spec = self.network.spec
        parts = torch.from_numpy(number_parts(spec.facets))
        objects = torch.from_numpy(number_objects(spec.facets, whole=True))
        rows = torch.arange(len(by_place))
        scores = by_place.clone()
        facets = []
        places = []
        for _ in range(spec.objects // self.network.parts):
            best = scores.flatten(1).argmax(1)
            facet = best // scores.shape[2]
            place = best % scores.shape[2]
            facets.append(parts[facet])
            places.append(place[:, None].expand(-1, self.network.parts))
            # Neither the place nor the object is named again.
            scores[rows, :, place] = -torch.inf
            scores[objects == objects[facet][:, None]] = -torch.inf
        return torch.cat(facets, dim=1), torch.cat(places, dim=1)

    @torch.inference_mode()
    def look_around(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """Find all visible objects in images (n, H, W, 3) uint8.

        Returns:
            Their facets (n, m) int64, and their frames (n, m, 9).
        """
        features = self.network.encoder.features(images)
        facets, places = self.name(self.network.encoder.scores_by_place(features))
        cells = self.network.cells(places, facets)
        return facets, self.network.frames(features, cells)

    def check_fits(self, env: EnvConfig) -> None:
        """Check that the network was made for a task."""
        self.network.spec.check_fits(env, ())

    @property
    def depends_on_rows(self) -> bool:
        """Whether episodes of different rows have different knowledge."""
        return len(self.knowledge) > 1

    def of_rows(self, rows: Tensor) -> Tensor:
        """Return what is known of rows (n,) int64, (n, D); their numbers may not matter."""
        if self.depends_on_rows:
            return self.knowledge[rows]
        return self.knowledge.expand(len(rows), -1)

    @torch.inference_mode()
    def forward(self, images: Tensor, rows: Tensor) -> Tensor:
        """Find the frames of episodes of some rows, in batches; see `locate`."""
        return in_batches(self.locate, images, self.of_rows(rows))

    def make_agent(self, policy: Policy, **options: Any) -> PolicyAgent:
        """Make an agent that acts on these frames; options as `PolicyAgent`."""
        return PolicyAgent(policy, recognition=self, **options)


class SeenAnswers(NamedTuple):
    """What answer grounding finds in n images."""

    frames: Tensor
    """Grasp frame at the chosen place, (n, 9) float32."""
    scores: Tensor
    """Log-sum-exp over the answering facets at every place, (n, P) float32."""
    named: Tensor
    """Facets of the m visible objects, surest first, (n, m) int64."""
    places: Tensor
    """Where they stand, (n, m) int64."""
    answering: Tensor
    """Whether these facets answer, more probably than not, (n, m) bool."""
    likelihoods: Tensor
    """Probability that each facet stands there, 0 where it does not answer, (n, F, m) float32."""

    @property
    def visible(self) -> Tensor:
        """Number of the named facets that answer, (n,) int64."""
        return self.answering.sum(1)

    def candidates(self, thresholds: Tensor | None) -> Tensor:
        """Return which objects may answer, (n, m): by likelihoods, or without thresholds by name.

        ``thresholds`` (F,) are the likelihoods from which a facet alone makes a candidate; several
        facets together need shares of theirs that add up to 1.
        """
        if thresholds is None:
            return self.answering
        # 0 / 0: a threshold of 0 is always reached
        shares = (self.likelihoods / thresholds[:, None]).nan_to_num(nan=1.0)
        return shares.sum(1) >= 1


class AnswerGrounding(FrameRecognition):
    """Recognition of grasp frames by the answers of a graph, with the same grounding network.

    ``knowledge`` (rows, F) is the probability that a facet of the network answers the query of a
    row: 1 or 0, but for facts with a confidence.
    """

    def see(self, images: Tensor, knowledge: Tensor) -> SeenAnswers:
        """Find the answers to queries, as `locate`."""
        frames, scores, by_place = self._find(images, knowledge)
        named, places = self.name(by_place)
        at_place = by_place.take_along_dim(places[:, None], 2)  # (n, F, m)
        part = self.network.part_of
        is_other = part[:, None] != part[named][:, None]  # of another part, (n, F, m)
        likelihoods = at_place.masked_fill(is_other, -torch.inf).softmax(1)
        # What answers more probably than not counts; how probably decides which one is chosen.
        likelihoods *= (knowledge >= SURE)[:, :, None]
        answering = knowledge.gather(1, named) >= SURE
        return SeenAnswers(frames, scores, named, places, answering, likelihoods)

    def place_scores(self, images: Tensor, knowledge: Tensor) -> Tensor:
        """As `FrameRecognition.place_scores`."""
        return self._find(images, knowledge)[1]

    def locate(self, images: Tensor, knowledge: Tensor) -> Tensor:
        """As `FrameRecognition.locate`."""
        return self._find(images, knowledge)[0]

    def make_agent(self, policy: Policy, **options: Any) -> PolicyAgent:
        """Make an agent that acts on these frames; options as `AnsweringAgent`."""
        return AnsweringAgent(policy, self, **options)

    def _find(self, images: Tensor, knowledge: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return frames (n, 9), scores (n, P) and those by facet (n, F, P) for answers (n, F)."""
        encoder = self.network.encoder
        features = encoder.features(images)
        by_place = encoder.scores_by_place(features)
        # Where nothing answers, every facet counts, so that there is a place to guess.
        counted = torch.where((knowledge > 0).any(1, keepdim=True), knowledge, 1.0)
        answering = by_place + counted.log()[:, :, None]
        scores = answering.logsumexp(1)
        place = scores.argmax(1)
        index = place[:, None, None].expand(-1, answering.shape[1], 1)
        facet = answering.gather(2, index).squeeze(2).argmax(1)
        cell = self.network.cells(place, facet)
        frames = self.network.frames(features, cell[:, None])[:, 0]
        return frames, scores, by_place


class AnsweringAgent(PolicyAgent):
    """Policy agent that moves to the object that answers by a graph, and says if it sees none.

    Its `notes` are "places", where the named objects stand, and "candidates", which of them may
    answer, (n, m) each.

    Args:
        policy: as `PolicyAgent`.
        recognition: the answers and where they stand.
        unclear: what to do where no visible object answers, or several do.
        thresholds: likelihoods from which a visible object counts as an answer, by facet, (F,); see
            `calibration`. None counts those whose name answers.
        **options: as `PolicyAgent`.
    """

    recognition: AnswerGrounding

    def __init__(
        self,
        policy: Policy,
        recognition: AnswerGrounding,
        *,
        unclear: Unclear = "guess",
        thresholds: Tensor | None = None,
        **options: Any,
    ) -> None:
        super().__init__(policy, recognition=recognition, **options)
        self.unclear = unclear
        self.thresholds = thresholds

    def recognize(self, images: Tensor) -> Tensor:
        """As `PolicyAgent.recognize`; notes which objects may answer."""
        answers = self.recognition.of_rows(self.rows)
        batches = map(self.recognition.see, images.split(BATCH), answers.split(BATCH))
        seen = SeenAnswers(*map(torch.cat, zip(*batches, strict=True)))
        self.notes = {
            "places": seen.places.numpy(),
            "candidates": seen.candidates(self.thresholds).numpy(),
        }
        return seen.frames

    @property
    def visible_answers(self) -> np.ndarray:
        """How many visible objects may answer in each environment, (n,) int64."""
        return self.notes["candidates"].sum(1)

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """As `PolicyAgent.act`; ``unclear`` decides who stays.

        Action 0 adds nothing to the joint targets.
        """
        actions = super().act(observations)  # counts the answers in the first image
        return np.where(self.moves[:, None], actions, 0)

    @property
    def moves(self) -> np.ndarray:
        """Whether the arm moves in each environment, (n,) bool."""
        if self.unclear == "guess":
            return np.ones(len(self.rows), np.bool_)
        count = self.visible_answers
        if self.unclear == "seen":
            return count >= 1
        return count == 1


class PerceivingVectorEnv(TorchArmVectorEnv):
    """Training environments whose knowledge is what a copy of a recognition computes.

    It is computed from the first image of every episode and kept until the next begins. Once a
    teacher is in use, it is what the simulator knows instead: practice starts hide objects from
    the image, and a wrong goal would contradict the teacher's actions. Destinations that differ
    between episodes are known with a teacher alone.
    """

    def __init__(
        self,
        config: EnvConfig,
        num_envs: int,
        recognition: FrameRecognition,
        **options: Any,
    ) -> None:
        recognition.check_fits(config)
        super().__init__(config, num_envs, **options)
        self._recognition = copy.deepcopy(recognition).to(self.device)
        self._perceived = torch.zeros(
            (num_envs, seen_width(config)), device=self.device
        )

    @property
    def knowledge(self) -> Tensor:
        """As `TorchArmVectorEnv.knowledge`."""
        return self._perceived

    def get_state(self) -> Arrays:
        """As `TorchArmVectorEnv.get_state`, with what was recognized."""
        return super().get_state() | to_arrays({"perceived": self._perceived})

    def set_state(self, state: Arrays) -> None:
        """As `TorchArmVectorEnv.set_state`."""
        state = dict(state)
        perceived = state.pop("perceived", None)
        if perceived is None or perceived.shape != self._perceived.shape:
            raise UserError(
                "The state does not hold what was recognized in this number of environments: "
                "it belongs to another kind of environment."
            )
        self._perceived = torch.tensor(perceived, device=self.device)
        super().set_state(state)

    def _observe(self) -> Tensor:
        """Draw the images; then compute the knowledge of the episodes that start with them."""
        images = super()._observe()
        ids = self._tensor(np.flatnonzero(self.running.steps == 0))
        if not len(ids):
            return images
        if self.has_teacher:
            perceived = self._true(ids.cpu().numpy())
        elif self.config.task.skill.tells_facts:
            raise UserError(
                "Only a teacher tells a policy in training where to put an object, and this "
                "algorithm uses none. Train with 'distil'."
            )
        else:
            perceived = self._recognition(images[ids], self.knowledge_input[ids])
        self._perceived = self._perceived.index_copy(0, ids, perceived)
        return images

    def _true(self, ids: NDArray[np.int64]) -> Tensor:
        """Return what the simulator knows of episodes (k,): frames, and destinations."""
        frames = self._recognition.true_frames(self.running, ids)
        if not self.config.task.skill.tells_facts:
            return frames
        places = self.running.memory[DESTINATION][ids]
        return torch.cat([frames, self._recognition.destinations(places)], dim=1)


@torch.inference_mode()
def known_in_episode(agent: PolicyAgent, image: np.ndarray) -> Arrays:
    """Return what an agent knows in the episode of one environment with this first image.

    ``knowledge`` (K,) is what its policy receives, ``recognition`` (P, P) the likelihood of the
    places where its network looks for the object; what it does not have is left out.
    """
    if not agent.policy.uses_knowledge:
        return {}
    images = torch.as_tensor(image[None])
    knowledge = agent.knowledge
    if knowledge is None:
        knowledge = agent.recognize(images)
    arrays = {"knowledge": knowledge[0].numpy()}
    recognition = agent.recognition
    if recognition is not None:
        scores = recognition.place_scores(images, recognition.of_rows(agent.rows))
        likelihood = scores[0].softmax(0)
        side = round(len(likelihood) ** 0.5)
        arrays["recognition"] = likelihood.reshape(side, -1).numpy()
    return arrays
