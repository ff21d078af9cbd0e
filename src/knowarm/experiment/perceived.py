"""Perceived knowledge: what a policy is told about an episode, read from its first image.

Nothing of the simulator's labels is read here. Of the environment it takes the images and, where
episodes ask, the query.
"""

from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.experiment.grounding import FRAME, Grounding
from knowarm.experiment.perception import (
    Perception,
    check_fits,
    digest,
    perception_of,
)
from knowarm.experiment.perception_training import answers_of
from knowarm.experiment.run_folder import RunFolder
from knowarm.knowledge.config import KnowledgeConfig
from knowarm.policy import PolicyAgent
from knowarm.reading import reading
from knowarm.world.config import EnvConfig
from knowarm.world.torch_env import TorchReachVectorEnv

FILE = "perception.safetensors"
"""Name of the module's file in a run folder."""

Spec = tuple[tuple[int, ...], torch.dtype]
"""Shape and dtype of what is told about one episode."""

BATCH = 256
"""Most images that are named at once."""


class Perceiver:
    """Selects the row of the knowledge table by what a perception module names.

    Where one object is visible it is the facet named most surely. Where the task asks, it is the
    surest of the facets that, as the graph says, answer the query.

    Args:
        perception: the module.
        env: the task.
        facets: the task's (object, colour) pairs, the rows of the knowledge table.
        device: of images and rows.

    Raises:
        UserError: the module was made for something else.
    """

    TOLD: ClassVar[Spec] = ((), torch.int64)

    def __init__(
        self,
        perception: Perception,
        env: EnvConfig,
        facets: tuple[tuple[str, str], ...],
        device: torch.device | str = "cpu",
    ) -> None:
        check_fits(perception.seen, env, facets)
        self._perception = perception.to(device)
        known = perception.seen.facets
        self._columns = torch.tensor([known.index(facet) for facet in facets], device=device)
        self._answers: Tensor | None = None
        if env.choice is not None:
            self._answers = torch.from_numpy(answers_of(env, facets)).to(device)

    @torch.inference_mode()
    def __call__(self, images: Tensor, queries: Tensor | None) -> Tensor:
        """Name what n images show.

        Args:
            images: (n, H, W, 3) uint8.
            queries: (n,) int64, number of each episode's query; not read where none is asked.

        Returns:
            (n,) int64, rows of the knowledge table.
        """
        parts = [self._perception(part) for part in images.split(BATCH)]
        scores = torch.cat(parts)[:, self._columns]
        if self._answers is not None:
            assert queries is not None
            scores = scores.masked_fill(~self._answers[queries], -torch.inf)
        return scores.argmax(1)


class Grounder:
    """Predicts the grasp frame of what the query means.

    Args:
        grounding: the network.
        env: the task.
        device: of images and queries.

    Raises:
        UserError: the network was made for something else.
    """

    TOLD: ClassVar[Spec] = ((FRAME,), torch.float32)

    def __init__(
        self, grounding: Grounding, env: EnvConfig, device: torch.device | str = "cpu"
    ) -> None:
        check_fits(grounding.seen, env, ())
        self._grounding = grounding.to(device)

    @torch.inference_mode()
    def __call__(self, images: Tensor, queries: Tensor | None) -> Tensor:
        """Find what the queries (n,) int64 of n images mean: (n, 9); see `Grounding.found`."""
        assert queries is not None
        parts = zip(images.split(BATCH), queries.split(BATCH), strict=True)
        return torch.cat([self._grounding.found(*part) for part in parts])


def perceiver(
    module: Perception,
    env: EnvConfig,
    facets: tuple[tuple[str, str], ...],
    device: torch.device | str = "cpu",
) -> Perceiver | Grounder:
    """Return what a module tells a policy by; arguments as `Perceiver`."""
    if isinstance(module, Grounding):
        return Grounder(module, env, device)
    return Perceiver(module, env, facets, device)


def module_of(data: bytes, path: Path = Path(FILE)) -> Perception:
    """Build the module of a run, perception or grounding, from the content of its file.

    Raises:
        UnreadableFileError: the content is damaged or of another format.
    """
    return perception_of(data, path, (Perception, Grounding))


class PerceivingVectorEnv(TorchReachVectorEnv):
    """Training environments whose facet is what a module sees.

    That is the row of the knowledge table that a perception module selects, or the grasp frame that
    a grounding network predicts.

    Args:
        config: the task.
        num_envs: n.
        perception: the module.
        **options: further arguments of `TorchReachVectorEnv`.
    """

    def __init__(
        self, config: EnvConfig, num_envs: int, perception: Perception, **options: Any
    ) -> None:
        super().__init__(config, num_envs, **options)
        self._perceive = perceiver(perception, config, self.facets, self.device)
        shape, dtype = self._perceive.TOLD
        self._told = torch.zeros((num_envs, *shape), dtype=dtype, device=self.device)

    @property
    def facet_ids(self) -> Tensor:
        """What is told about each current episode: (n,) int64 rows, or (n, 9) float32."""
        return self._told

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Tensor, dict[str, Any]]:
        """As `TorchReachVectorEnv.reset`; then names what the new episodes show."""
        images, infos = super().reset(seed=seed, options=options)
        mask = (options or {}).get("reset_mask")
        fresh = self._everywhere if mask is None else torch.as_tensor(mask, device=self.device)
        self._look(images, fresh)
        return images, infos

    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """As `TorchReachVectorEnv.step`; then names what the new episodes show."""
        result = super().step(actions)
        self._look(result[0], result[2] | result[3])
        return result

    def get_state(self) -> dict[str, np.ndarray]:
        """As `TorchReachVectorEnv.get_state`, with what is told."""
        return super().get_state() | {"perceived": self._told.cpu().numpy().copy()}

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """As `TorchReachVectorEnv.set_state`."""
        state = dict(state)
        if "perceived" not in state or state["perceived"].shape != self._told.shape:
            raise UserError(
                "The state does not hold what a module saw in this number of environments: it "
                "belongs to another kind of environment."
            )
        self._told = torch.from_numpy(np.array(state.pop("perceived"))).to(self.device)
        super().set_state(state)

    def _look(self, images: Tensor, fresh: Tensor) -> None:
        """Look at the environments of a mask (n,); what is told about the others stays."""
        queries = super().facet_ids if self.config.choice is not None else None
        if self._on_host:  # few episodes end in one step
            ids = fresh.nonzero().squeeze(1)
            if len(ids):
                told = self._told.clone()
                told[ids] = self._perceive(images[ids], None if queries is None else queries[ids])
                self._told = told
        else:  # on a GPU nothing waits for the device
            new = self._perceive(images, queries)
            where = fresh.view(-1, *[1] * (new.ndim - 1))
            self._told = torch.where(where, new, self._told)


class PerceivingAgent(PolicyAgent):
    """Policy agent that is told what its module names, or finds, in the first image.

    Args:
        perception: the module.
        *arguments: those of `PolicyAgent`.
        **options: those of `PolicyAgent`.
    """

    def __init__(self, perception: Perception, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.perception = perception

    def start(self, env: Any) -> None:
        """As `PolicyAgent.start`; the next image is the first of every episode."""
        super().start(env)
        self._perceive = perceiver(self.perception, env.config, env.facets)
        self._asks = env.config.choice is not None
        self.told: Tensor | None = None

    def facets_for(self, observations: np.ndarray) -> Tensor:
        """As `PolicyAgent.facets_for`, as seen in the first image."""
        if self.told is None:
            queries = torch.as_tensor(self._env.facet_ids) if self._asks else None
            self.told = self._perceive(torch.as_tensor(observations), queries).clone()
        return self.told


def perception_for(
    knowledge: KnowledgeConfig, data: bytes | None, path: Path = Path(FILE)
) -> Perception | None:
    """Return the perception module of an agent; None for one that needs none.

    Args:
        knowledge: what the agent is told.
        data: content of the module's file.
        path: the file, for messages.

    Raises:
        UserError: the agent needs a module and none is given, or the reverse.
    """
    if knowledge.scope != "perceived":
        if data is not None:
            raise UserError(
                f"Knowledge of scope {knowledge.scope!r} does not depend on what is perceived: "
                "leave perception out, or take an agent whose scope is 'perceived'."
            )
        return None
    if data is None:
        raise UserError(
            "Knowledge of scope 'perceived' needs a perception module: pass perception=FILE. Make "
            "one with `knowarm perception train EXPERIMENT --out FILE`."
        )
    return perception_of(data, path)


def stored_perception(folder: RunFolder) -> bytes:
    """Read the perception module that a run folder keeps.

    Raises:
        UnreadableFileError: it is missing, damaged, or not the one that the run was trained with.
    """
    path = folder.path / FILE
    with reading(path, "Restore the file, or train again."):
        data = path.read_bytes()
        if digest(data) != folder.provenance()["perception"]["digest"]:
            raise ValueError("it is not the module that this run was trained with")
    return data


def describe_module(data: bytes) -> dict[str, Any]:
    """Return what provenance says about a perception module: digest, purpose and accuracy."""
    return {"digest": digest(data), **to_dict(module_of(data).seen)}
