"""Renderer, knowledge and a state go in; action logits, values and the next state come out.

Dimension letters here and in `knowarm.learn`: T time, B batch, H height (of a image) or
hidden size (of a state), W width, K knowledge, J joints, A levels of an action, S and L blocks
and pixel values of a image's patches.
"""

from typing import Literal

import torch
from torch import Tensor, nn

from knowarm.policy.config import PolicyConfig
from knowarm.policy.encoder import ImageEncoder
from knowarm.policy.fusion import FUSIONS
from knowarm.policy.initialization import RELU_GAIN, orthogonal
from knowarm.policy.memory import Memory, State

MatmulPrecision = Literal["float32", "tf32", "bfloat16"]


class Policy(nn.Module):
    """The paper's network (section 4.2.2): two convolutions, one layer, an LSTM, J + 1 heads.

    Args:
        config: sizes and the place where knowledge enters.
        seed: draws the weights; the same seed gives the same policy.

    Attributes:
        precision: of the products in encoder and memory; parameters, cell, heads and losses are
            float32 always. "bfloat16" is for training on processors that have it in hardware;
            "tf32" leaves float32 to be rounded by a GPU that was told so.
    """

    def __init__(self, config: PolicyConfig, *, seed: int = 0) -> None:
        super().__init__()
        self.config = config
        self.encoder = ImageEncoder(config.image_size, config.pixel_shift, config.pixel_scale)
        self.knowledge_encoder = (
            nn.Linear(config.knowledge_dim, config.encoded_width, bias=False)
            if config.knowledge_encoder == "learned" and config.fusion != "none"
            else nn.Identity()
        )
        self.fusion = FUSIONS[config.fusion](config)
        self.fc = nn.Linear(self.encoder.width + self.fusion.fc_growth, config.features)
        self.memory = Memory(config.features + self.fusion.memory_growth, config.hidden_size)
        self.actor = nn.Linear(
            config.hidden_size + self.fusion.actor_growth, config.joints * config.levels
        )
        self.critic = nn.Linear(config.hidden_size + self.fusion.critic_growth, 1)
        self.matmul_precision: MatmulPrecision = "float32"
        self.reset_parameters(torch.Generator().manual_seed(seed))

    def reset_parameters(self, generator: torch.Generator) -> None:
        """Draw all weights orthogonal; biases start at zero."""
        orthogonal(self.encoder.conv1, RELU_GAIN, generator)
        orthogonal(self.encoder.conv2, RELU_GAIN, generator)
        orthogonal(self.knowledge_encoder, 1.0, generator)
        self.fusion.reset_parameters(generator)
        orthogonal(self.fc, RELU_GAIN, generator)
        orthogonal(self.memory, 1.0, generator)
        for head in self.actor.weight.data.split(self.config.levels):
            nn.init.orthogonal_(head, self.config.actor_gain, generator=generator)
        nn.init.zeros_(self.actor.bias)
        orthogonal(self.critic, 1.0, generator)

    def initial_state(self, batch: int) -> State:
        """Return the state before the first step: (h, c), each (B, H) of zeros."""
        return self.memory.initial_state(batch)

    def patches(self, image: Tensor) -> Tensor:
        """Take the pixels the network looks at: (..., H, W, 3) uint8 -> (..., S, L) uint8.

        They have no gradient and depend on no parameter: a rollout keeps them in place of the
        images, and spares every pass over it the cutting; see `ImageEncoder.patches`.
        """
        return self.encoder.patches(image)

    def step(
        self, patches: Tensor, knowledge: Tensor, state: State, episode_start: Tensor
    ) -> tuple[Tensor, Tensor, State]:
        """Advance every environment by one step.

        Args:
            patches: (B, S, L) uint8, `patches` of the images.
            knowledge: (B, K) float32.
            state: (h, c) after the step before, each (B, H).
            episode_start: (B,) bool, true where the image is the first of an episode; the
                state is forgotten there.

        Returns:
            logits (B, J, A), values (B,), next state.
        """
        knowledge = self.knowledge_encoder(knowledge)
        with self._products():
            features = self._features(patches, knowledge)
            hidden, state = self.memory.step(features, state, episode_start)
        logits, value = self._heads(hidden, knowledge)
        return logits, value, state

    def unroll(
        self, patches: Tensor, knowledge: Tensor, state: State, episode_start: Tensor
    ) -> tuple[Tensor, Tensor, State]:
        """Advance T steps at once, for training.

        Args:
            patches: (T, B, S, L) uint8, `patches` of the images.
            knowledge: (T, B, K) float32.
            state: (h, c) before the first step, each (B, H).
            episode_start: (T, B) bool.

        Returns:
            logits (T, B, J, A), values (T, B), state after the last step.
        """
        steps, batch = episode_start.shape
        knowledge = self.knowledge_encoder(knowledge.flatten(0, 1))
        with self._products():
            features = self._features(patches.flatten(0, 1), knowledge).view(steps, batch, -1)
            hidden, state = self.memory.unroll(features, state, episode_start)
        logits, value = self._heads(hidden.flatten(0, 1), knowledge)
        return logits.view(steps, batch, *logits.shape[1:]), value.view(steps, batch), state

    def parameter_counts(self) -> dict[str, int]:
        """Count parameters by group, and in total."""
        groups: dict[str, list[nn.Module]] = {
            "image": [self.encoder, self.fc],
            "knowledge": [self.knowledge_encoder, self.fusion],
            "memory": [self.memory],
            "actor": [self.actor],
            "critic": [self.critic],
        }
        counts = {
            name: sum(p.numel() for module in modules for p in module.parameters())
            for name, modules in groups.items()
        }
        return {**counts, "total": sum(counts.values())}

    def _products(self) -> torch.autocast:
        """Context in which matrix products and convolutions have the policy's precision."""
        low, device = self.matmul_precision == "bfloat16", self.critic.weight.device.type
        # Every weight is used once: keeping its copy gains nothing and a CUDA graph forbids it.
        return torch.autocast(device, torch.bfloat16, enabled=low, cache_enabled=False)

    def _features(self, patches: Tensor, knowledge: Tensor) -> Tensor:
        """(N, S, L) and (N, K) -> inputs of the LSTM."""
        x = self.fusion.before_fc(self.encoder(patches), knowledge)
        return self.fusion.before_lstm(torch.relu(self.fc(x)), knowledge)

    def _heads(self, hidden: Tensor, knowledge: Tensor) -> tuple[Tensor, Tensor]:
        """(N, H) and (N, K) -> logits (N, J, A), values (N,)."""
        logits = self.actor(self.fusion.before_actor(hidden, knowledge))
        value = self.critic(self.fusion.before_critic(hidden, knowledge))
        return logits.view(-1, self.config.joints, self.config.levels), value.squeeze(1)
