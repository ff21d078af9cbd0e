"""Seeds and a mask of what ended go in; the episodes now running come out, on one device."""

from dataclasses import fields
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from knowarm.world.appearance import AppearanceSource, Shown
from knowarm.world.config import EnvConfig
from knowarm.world.episodes import Episodes, EpisodeSource
from knowarm.world.scene import Scene, target_places

_STATE = ("streams", "next_episode", "target", "colour", "position", "look")
"""Tensors that determine everything else."""


class RunningEpisodes:
    """The episode that each of n environments plays: its target, look and grasp frame.

    An episode is drawn for every environment and kept where one begins, which on a GPU is cheaper
    than to ask the host where that is. No tensor is written twice: each may be handed out.

    Attributes:
        target: (n,) int64. colour: (n,) int64, among the target's.
        position: (n, 2) float64, x and y of the target [m]. look: (n, L) float64 draws.
        grasp_position: (n, 3) float32 [m], world.
        grasp_matrix: (n, 3, 3) float32, rotation from grasp frame to world.
        shown: how the environments look.

    Args:
        scene: the robot and targets.
        config: what is drawn.
        num_envs: n.
        device: where the tensors lie.
    """

    def __init__(
        self, scene: Scene, config: EnvConfig, num_envs: int, device: torch.device
    ) -> None:
        def place(array: NDArray[Any]) -> Tensor:
            return torch.as_tensor(array, device=device)

        self._place = place
        self._scene = scene
        self._source = EpisodeSource(scene, config, place)
        self._appearance = AppearanceSource(scene, config.randomization, place)
        self._grasp_offset = place(scene.grasp_position)
        self._grasp_turn = place(scene.grasp_matrix.astype(np.float32))
        seeds = np.random.SeedSequence().generate_state(num_envs, np.uint64)
        self.streams = place(seeds.view(np.int64))
        self.next_episode = torch.zeros_like(self.streams)
        drawn: Any = self._source(self.streams, self.next_episode)
        self.target: Tensor = drawn.target
        self.colour: Tensor = drawn.colour
        self.position: Tensor = drawn.position
        self.look: Tensor = drawn.look
        self._refresh()

    def seed(self, ids: NDArray[np.intp], values: NDArray[np.uint64]) -> None:
        """Begin environments' streams anew, (k,) ids and seeds of the host."""
        streams, numbers = self.streams.cpu().numpy().copy(), self.next_episode.cpu().numpy().copy()
        streams[ids], numbers[ids] = values.view(np.int64), 0
        self.streams, self.next_episode = self._place(streams), self._place(numbers)

    def start_next(self, mask: Tensor) -> Tensor:
        """Start the next drawn episode in the environments of a mask (n,).

        Returns:
            Start angle of each joint relative to home, of all environments, (n, J) float64 [rad].
        """
        episodes = self._source(self.streams, self.next_episode)
        self.next_episode = self.next_episode + mask
        return self._start(mask, episodes)

    def start_given(self, ids: NDArray[np.intp], mask: Tensor, episodes: Episodes) -> Tensor:
        """Start given episodes of the host, k, in the environments of ids (k,) and mask (n,).

        Returns:
            As ``start_next``.

        Raises:
            UserError: they were drawn for another randomization.
        """
        self._appearance.check(episodes)
        spread: list[Any] = []
        for field in fields(episodes):
            values = getattr(episodes, field.name)
            every = np.zeros((len(self.target), *values.shape[1:]), dtype=values.dtype)
            every[ids] = values
            spread.append(self._place(every))
        return self._start(mask, Episodes(*spread))

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Copy everything to the host."""
        return {name: getattr(self, name).cpu().numpy().copy() for name in _STATE}

    def set_state(self, state: dict[str, NDArray[Any]]) -> None:
        """Go on from a state of ``get_state``; other arrays in it are left alone."""
        for name in _STATE:
            setattr(self, name, self._place(np.array(state[name])))
        self._refresh()

    def _start(self, mask: Tensor, new: Any) -> Tensor:
        """Keep new ``Episodes``, of tensors, where the mask is set."""
        rows = mask[:, None]
        self.target = torch.where(mask, new.target, self.target)
        self.colour = torch.where(mask, new.colour, self.colour)
        self.position = torch.where(rows, new.position, self.position)
        self.look = torch.where(rows, new.look, self.look)
        self._refresh()
        return new.joint_offsets

    def _refresh(self) -> None:
        """Bring grasp frames and looks in line with the episodes."""
        places = target_places(self._scene, self.position)
        self.grasp_position = (places + self._grasp_offset[self.target]).to(torch.float32)
        self.grasp_matrix = self._grasp_turn[self.target]
        self.shown: Shown = self._appearance(self.target, self.colour, self.position, self.look)
