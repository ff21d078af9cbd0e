"""Environments and agents whose policy receives what a perception module recognizes.

Of the environment they read the images and, where the task has queries, the query; no labels.
"""

import copy
from typing import Any

import numpy as np
import torch
from torch import Tensor

from knowarm.errors import UserError
from knowarm.perception.module import PerceptionModule, in_batches
from knowarm.policy import PolicyAgent
from knowarm.world.config import EnvConfig, facets_of, questions_of
from knowarm.world.envs.torch_env import TorchArmVectorEnv


class PerceivingVectorEnv(TorchArmVectorEnv):
    """Training environments whose knowledge input is what a copy of a module recognizes.

    It is computed from the first image of every episode and kept until the next begins. Once a
    teacher is in use, it is what the simulator knows instead: practice starts hide objects from
    the module, and a wrong goal would contradict the teacher's actions.
    """

    def __init__(
        self, config: EnvConfig, num_envs: int, module: PerceptionModule, **options: Any
    ) -> None:
        super().__init__(config, num_envs, **options)
        self._module = module = copy.deepcopy(module).to(self.device)
        self._predict = module.predictor(config, self.facets)
        shape, dtype = module.GOAL
        self._goal = torch.zeros((num_envs, *shape), dtype=dtype, device=self.device)

    @property
    def knowledge_input(self) -> Tensor:
        """Goal of each current episode: (n,) int64 rows, or (n, 9) float32 grasp frames."""
        return self._goal

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Tensor, dict[str, Any]]:
        """As `TorchArmVectorEnv.reset`; then computes the goals of the new episodes."""
        images, infos = super().reset(seed=seed, options=options)
        mask = (options or {}).get("reset_mask")
        fresh = self._everywhere if mask is None else torch.as_tensor(mask, device=self.device)
        self._update_goals(images, fresh)
        return images, infos

    def step(self, actions: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, dict[str, Any]]:
        """As `TorchArmVectorEnv.step`; then computes the goals of the new episodes."""
        result = super().step(actions)
        self._update_goals(result[0], result[2] | result[3])
        return result

    def get_state(self) -> dict[str, np.ndarray]:
        """As `TorchArmVectorEnv.get_state`, with the goals."""
        return super().get_state() | {"perceived": self._goal.cpu().numpy().copy()}

    def set_state(self, state: dict[str, np.ndarray]) -> None:
        """As `TorchArmVectorEnv.set_state`."""
        state = dict(state)
        goal = state.pop("perceived", None)
        if goal is None or goal.shape != self._goal.shape:
            raise UserError(
                "The state does not hold what a module recognized in this number of environments: "
                "it belongs to another kind of environment."
            )
        self._goal = torch.from_numpy(np.array(goal)).to(self.device)
        super().set_state(state)

    def _update_goals(self, images: Tensor, fresh: Tensor) -> None:
        """Compute the goals of the environments of a mask (n,); the others stay."""
        ids = fresh.nonzero().squeeze(1)
        if not len(ids):
            return
        goal = self._goal.clone()
        if self.has_teacher:
            goal[ids] = self._module.true_goals(self.running, ids.cpu().numpy())
        else:
            asked = None if questions_of(self.config) is None else super().knowledge_input[ids]
            goal[ids] = in_batches(self._predict, images[ids], asked)
        self._goal = goal


class PerceivingAgent(PolicyAgent):
    """Policy agent whose knowledge input is what a module recognizes in the first image."""

    def __init__(self, module: PerceptionModule, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.module = module

    def reset(self, batch: Any) -> None:
        """As `PolicyAgent.reset`; the next image is the first of every episode."""
        super().reset(batch)
        self._predict = self.module.predictor(batch.env, facets_of(batch.env))
        self._has_queries = questions_of(batch.env) is not None

    def recognize(self, images: Tensor) -> Tensor:
        """As `PolicyAgent.recognize`, computed from the images."""
        return in_batches(self._predict, images, self.rows if self._has_queries else None)


@torch.inference_mode()
def known_in_episode(agent: Any, image: np.ndarray) -> dict[str, np.ndarray]:
    """Return what an agent knows in the episode of one environment with this first image.

    ``knowledge`` (K,) is what its policy receives, ``recognition`` (P, P) the likelihood of the
    places where its network looks for the object; what it does not have is left out.
    """
    if not isinstance(agent, PolicyAgent) or not agent.policy.uses_knowledge:
        return {}
    images = torch.as_tensor(image[None])
    given = agent.recognize(images) if agent.knowledge is None else agent.knowledge
    table = agent.policy.knowledge_table
    found = {"knowledge": given[0] if given.is_floating_point() else table[given[0]]}
    place_scores = getattr(getattr(agent, "module", None), "place_scores", None)
    if place_scores is not None:
        scores = place_scores(images, agent.rows)[0].softmax(0)
        found["recognition"] = scores.reshape(round(len(scores) ** 0.5), -1)
    return {name: value.numpy() for name, value in found.items()}
