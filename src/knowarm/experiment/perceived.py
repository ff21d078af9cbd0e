"""Perceived knowledge: each episode's row of the knowledge table, named from its first image.

Nothing of the simulator's labels is read here. Of the environment it takes the images and, where
episodes ask, the query.
"""

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from knowarm.config import to_dict
from knowarm.errors import UserError
from knowarm.experiment.grounding import Grounding
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
    """Selects the place that a grounding network finds for the query.

    Args:
        grounding: the network.
        env: the task.
        device: of images and rows.

    Raises:
        UserError: the network was made for something else.
    """

    def __init__(
        self, grounding: Grounding, env: EnvConfig, device: torch.device | str = "cpu"
    ) -> None:
        check_fits(grounding.seen, env, ())
        self._grounding = grounding.to(device)

    @torch.inference_mode()
    def __call__(self, images: Tensor, queries: Tensor | None) -> Tensor:
        """Find what the queries (n,) int64 of n images mean: (n,) int64, rows of `place_table`."""
        assert queries is not None
        parts = zip(images.split(BATCH), queries.split(BATCH), strict=True)
        return torch.cat([self._grounding.places(*part) for part in parts])


def perceiver(
    module: Perception,
    env: EnvConfig,
    facets: tuple[tuple[str, str], ...],
    device: torch.device | str = "cpu",
) -> Perceiver | Grounder:
    """Return what selects rows by a module; arguments as `Perceiver`."""
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
    """Training environments whose facet is the row that a perception module selects.

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
        self._rows = torch.zeros(num_envs, dtype=torch.int64, device=self.device)

    @property
    def facet_ids(self) -> Tensor:
        """Row of the knowledge table for each current episode, as perceived, (n,) int64."""
        return self._rows

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
        """As `TorchReachVectorEnv.get_state`, with the rows."""
        return super().get_state() | {"perceived": self._rows.cpu().numpy().copy()}

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """As `TorchReachVectorEnv.set_state`."""
        state = dict(state)
        if "perceived" not in state or state["perceived"].shape != (self.num_envs,):
            raise UserError(
                "The state holds no perceived rows of this number of environments: it belongs to "
                "another kind of environment."
            )
        self._rows = torch.from_numpy(np.array(state.pop("perceived"))).to(self.device)
        super().set_state(state)

    def _look(self, images: Tensor, fresh: Tensor) -> None:
        """Name what the environments of a mask (n,) show; the others keep their rows."""
        queries = super().facet_ids if self.config.choice is not None else None
        if self._on_host:  # few episodes end in one step
            ids = fresh.nonzero().squeeze(1)
            if len(ids):
                rows = self._rows.clone()
                rows[ids] = self._perceive(images[ids], None if queries is None else queries[ids])
                self._rows = rows
        else:  # on a GPU nothing waits for the device
            self._rows = torch.where(fresh, self._perceive(images, queries), self._rows)


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
        self.rows: Tensor | None = None

    def rows_for(self, observations: np.ndarray) -> Tensor:
        """Return the row of the knowledge table of each episode, (n,) int64."""
        if self.rows is None:
            queries = torch.as_tensor(self._env.facet_ids) if self._asks else None
            self.rows = self._perceive(torch.as_tensor(observations), queries).clone()
        return self.rows


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
