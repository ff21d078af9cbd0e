"""Recurrent actor-critic policy of the paper (section 4.2.2), with knowledge fusion.

Dimension letters in `knowarm.policy` and `knowarm.learn`: T time steps, B batch (environments), N
images of a flattened batch, H and W height and width of an image, H also the hidden size of a
recurrent state, K knowledge vector, F facets (rows of the knowledge table), J joints, A levels of
an action, S blocks and L pixel values per block of an image's patches.

The action distribution is a softmax per joint: logits are (..., J, A), actions (..., J). Joints are
independent, so log-probabilities and entropies of an action are sums over the joints.
"""

from bisect import bisect_left
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Literal

import torch
from torch import Tensor, nn

from knowarm.errors import UserError
from knowarm.policy.config import FUSIONS, PolicyConfig, PolicyShape, hidden_size
from knowarm.policy.encoder import RELU_GAIN, ImageEncoder, orthogonal, orthogonal_
from knowarm.policy.lstm import MaskedLSTM, State
from knowarm.seeding import torch_generator

MatmulPrecision = Literal["float32", "bfloat16"]
"""Precision of matrix products."""


class Policy(nn.Module):
    """Two convolutions, a fully connected layer, an LSTM, J actor heads and a critic.

    Images may be given as such, as the patches that `patches` returns, or as what the encoder makes
    of these; the number of axes tells which. Patches spare a training loop the repeated gathering
    of pixels.

    Args:
        config: the choices.
        shape: sizes given by robot, image and knowledge.
        seed: of the initial weights.

    Attributes:
        resolved_config: ``config`` with the capacity control (``wide``) replaced by the sizes it
            leads to; equal to ``config`` otherwise.
        hidden_size: H.
        matmul_precision: of the products in encoder and LSTM; parameters, cell state, heads and
            losses are always float32.

    Raises:
        UserError: the sizes do not fit each other.
    """

    def __init__(
        self,
        config: PolicyConfig,
        shape: PolicyShape,
        *,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.config = config
        self.shape = shape
        if config.wide:
            config = matched_without_knowledge(config, shape)
        self.resolved_config = config
        hidden = hidden_size(config, shape)
        knowledge = shape.knowledge_dim
        self.hidden_size = hidden
        self.encoder = ImageEncoder(
            shape.image_size, config.pixel_shift, config.pixel_scale
        )
        self.knowledge_encoder: nn.Module = nn.Identity()
        if self.uses_knowledge and config.knowledge_encoder == "learned":
            self.knowledge_encoder = nn.Linear(knowledge, knowledge, bias=False)
        fusion = FUSIONS[config.fusion](
            config.features, knowledge, shape.knowledge_slots
        )
        self.fusion = fusion
        self.fc = nn.Linear(
            self.encoder.width + fusion.extra_inputs("fc"), config.features
        )
        self.memory = MaskedLSTM(config.features + fusion.extra_inputs("lstm"), hidden)
        self.actor = nn.Linear(
            hidden + fusion.extra_inputs("actor"), shape.joints * shape.levels
        )
        self.critic = nn.Linear(hidden + fusion.extra_inputs("critic"), 1)
        self._has_relu = config.fc_activation == "relu"
        self.matmul_precision: MatmulPrecision = "float32"
        if not self.critic.weight.is_meta:
            self.reset_parameters(torch_generator(seed, "weights"))

    @property
    def uses_knowledge(self) -> bool:
        """Whether the knowledge vector enters the network anywhere."""
        return self.resolved_config.fusion != "none"

    def reset_parameters(self, generator: torch.Generator) -> None:
        """Initialize all weights orthogonally and all biases with zeros."""
        orthogonal(self.encoder.conv1, RELU_GAIN, generator)
        orthogonal(self.encoder.conv2, RELU_GAIN, generator)
        for layer in self.knowledge_encoder.modules():
            orthogonal(layer, 1.0, generator)
        self.fusion.reset_parameters(generator)
        orthogonal(self.fc, RELU_GAIN if self._has_relu else 1.0, generator)
        orthogonal(self.memory, 1.0, generator)
        for head in self.actor.weight.data.split(self.shape.levels):
            orthogonal_(head, self.config.actor_gain, generator)
        nn.init.zeros_(self.actor.bias)
        orthogonal(self.critic, 1.0, generator)

    def initial_state(self, batch: int) -> State:
        """Return the state before the first step: (h, c), zeros (B, H) each."""
        return self.memory.initial_state(batch)

    def patches(self, image: Tensor) -> Tensor:
        """Gather the pixels that the network reads: (..., H, W, 3) uint8 -> (..., S, L) uint8.

        Patches have no gradient and depend on no parameter, so a rollout stores them instead of
        the images; see `ImageEncoder.patches`.
        """
        return self.encoder.patches(image)

    @property
    def knowledge_width(self) -> int:
        """Number K of numbers per episode that the network reads as knowledge; 0 without."""
        if not self.uses_knowledge:
            return 0
        return self.shape.knowledge_dim

    def check_knowledge(self, knowledge: Tensor) -> None:
        """Check that the knowledge of an environment's episodes fits, as `step` takes it.

        Raises:
            UserError: it has another width or dtype.
        """
        width = self.knowledge_width
        if knowledge.shape[1:] != (width,) or knowledge.dtype != torch.float32:
            raise UserError(
                f"The environment's knowledge is {tuple(knowledge.shape)} {knowledge.dtype}, and "
                f"the policy expects vectors of {width} float32 numbers: build both from the same "
                "experiment."
            )

    def step(
        self,
        image: Tensor,
        knowledge: Tensor,
        state: State,
        episode_start: Tensor,
    ) -> tuple[Tensor, Tensor, State]:
        """Advance every environment by one step.

        Args:
            image: (B, H, W, 3) uint8, their patches (B, S, L) uint8, or these encoded, (B, width).
            knowledge: (B, K) float32; K is 0 for a policy without knowledge.
            state: (h, c) after the previous step, (B, H) each.
            episode_start: (B,) bool, true where the image is the first of an episode; the
                state is reset there.

        Returns:
            Logits (B, J, A), values (B,), next state.
        """
        knowledge = self.knowledge_encoder(knowledge)
        with self.autocast():
            inputs = self.fusion("lstm", self._features(image, knowledge), knowledge)
            hidden, state = self.memory.step(inputs, state, episode_start)
        logits, value = self._heads(hidden, knowledge)
        return logits, value, state

    def unroll(
        self,
        image: Tensor,
        knowledge: Tensor,
        state: State,
        episode_start: Tensor,
    ) -> tuple[Tensor, Tensor, State]:
        """Advance every environment by T steps; see `unroll_with_features`."""
        return self.unroll_with_features(image, knowledge, state, episode_start)[:3]

    def unroll_with_features(
        self,
        image: Tensor,
        knowledge: Tensor,
        state: State,
        episode_start: Tensor,
    ) -> tuple[Tensor, Tensor, State, Tensor]:
        """Advance every environment by T steps, for training.

        Arguments are those of `step` with a leading axis T; ``state`` precedes the first step.

        Returns:
            Logits (T, B, J, A), values (T, B), state after the last step, and the features of the
            images (T * B, features) that the LSTM receives with the knowledge.
        """
        steps, batch = episode_start.shape
        knowledge = self.knowledge_encoder(knowledge).flatten(0, 1)
        with self.autocast():
            features = self._features(image.flatten(0, 1), knowledge)
            inputs = self.fusion("lstm", features, knowledge).view(steps, batch, -1)
            hidden, state = self.memory(inputs, state, episode_start)
        logits, value = self._heads(hidden.flatten(0, 1), knowledge)
        logits = logits.view(steps, batch, *logits.shape[1:])
        return logits, value.view(steps, batch), state, features

    def parameter_counts(self) -> dict[str, int]:
        """Count the parameters per group and in total."""
        groups: dict[str, tuple[nn.Module, ...]] = {
            "image": (self.encoder, self.fc),
            "knowledge": (self.knowledge_encoder, self.fusion),
            "memory": (self.memory,),
            "actor": (self.actor,),
            "critic": (self.critic,),
        }
        counts = {}
        for name, modules in groups.items():
            counts[name] = sum(p.numel() for p in nn.ModuleList(modules).parameters())
        counts["total"] = sum(counts.values())
        return counts

    def maker(self) -> "MakePolicy":
        """Return a function that builds a policy with this structure."""
        return partial(Policy, self.config, self.shape)

    @contextmanager
    def computing(self, precision: MatmulPrecision) -> Iterator[None]:
        """Use a precision of products, in place of float32, until the context ends."""
        self.matmul_precision = precision
        try:
            yield
        finally:
            self.matmul_precision = "float32"

    def autocast(self) -> torch.autocast:
        """Return a context in which products and convolutions have the policy's precision."""
        return torch.autocast(
            self.critic.weight.device.type,
            torch.bfloat16,
            enabled=self.matmul_precision == "bfloat16",
            cache_enabled=False,  # each weight is used once
        )

    def _features(self, image: Tensor, knowledge: Tensor) -> Tensor:
        """Compute the features of images (N, features) from any form of them and (N, K)."""
        if image.ndim == 4:
            image = self.patches(image)
        if image.ndim == 3:
            image = self.encoder(image)
        x = self.fusion("fc", image, knowledge)
        features: Tensor = self.fc(x)
        return torch.relu(features) if self._has_relu else features

    def _heads(self, hidden: Tensor, knowledge: Tensor) -> tuple[Tensor, Tensor]:
        """Compute logits (N, J, A) and values (N,) from (N, H) and (N, K)."""
        logits = self.actor(self.fusion("actor", hidden, knowledge))
        value = self.critic(self.fusion("critic", hidden, knowledge))
        return logits.view(-1, self.shape.joints, self.shape.levels), value.squeeze(1)


MakePolicy = Callable[[], Policy]
"""Builds a policy on the CPU with the initial weights of seed 0; picklable."""


def matched_without_knowledge(config: PolicyConfig, shape: PolicyShape) -> PolicyConfig:
    """Return the capacity control: no knowledge, same encoder, same number of parameters.

    Without knowledge the LSTM has fewer inputs; its hidden size is increased until the total
    number of parameters is as close as one unit more or less allows. The image encoder keeps its
    size, since more visual features would be another advantage.

    Args:
        config: a policy with knowledge; ``wide`` is ignored.
        shape: its shape, with the knowledge that it would get.
    """
    config = replace(config, wide=False)
    if shape.knowledge_dim == 0:
        return replace(config, fusion="none")

    def count(config: PolicyConfig) -> int:
        with torch.device("meta"):
            return Policy(config, shape).parameter_counts()["total"]

    target = count(config)

    def excess(hidden: int) -> int:
        return count(replace(config, fusion="none", hidden=hidden)) - target

    # The count grows with the hidden size: find the first that is not below the target.
    sizes = range(1, 2**20)
    high = bisect_left(sizes, 0, key=excess)
    nearest = sizes[max(0, high - 1) : high + 1]
    hidden = min(nearest, key=lambda hidden: abs(excess(hidden)))
    return replace(config, fusion="none", hidden=hidden)


def sample(logits: Tensor, generator: torch.Generator) -> Tensor:
    """Draw one level per joint from softmax(logits), by the Gumbel-max trick: int64 (..., J)."""
    noise = torch.empty_like(logits).exponential_(generator=generator)
    return (logits - noise.log()).argmax(-1)


def log_probabilities(logits: Tensor) -> Tensor:
    """Compute log softmax(logits) over the levels: (..., J, A).

    ``torch.log_softmax`` takes four times as long on rows of only A values.
    """
    return logits - logits.logsumexp(-1, keepdim=True)


def of_actions(values: Tensor, actions: Tensor) -> Tensor:
    """Select what belongs to actions (..., J) from values of all levels (..., J, A): (..., J)."""
    return values.gather(-1, actions[..., None]).squeeze(-1)


def log_probability(logits: Tensor, actions: Tensor) -> Tensor:
    """Compute the log-probability of actions (..., J), summed over joints [nat]: (...)."""
    return of_actions(log_probabilities(logits), actions).sum(-1)


def entropy(logits: Tensor) -> Tensor:
    """Compute the entropy of the action distribution, summed over joints [nat]: (...)."""
    log_p = log_probabilities(logits)
    return -(log_p.exp() * log_p).sum((-2, -1))
