"""Numeric reference: the whole network written with plain PyTorch layers and copied weights."""

import pytest
import torch
from torch import Tensor, nn

from knowarm.policy import Policy, PolicyConfig, PolicyShape

T, B, FACETS = 5, 3, 4


class Reference(nn.Module):
    """The paper's network (section 4.2.2), layer by layer, one image at a time."""

    def __init__(self, joints: int, knowledge: int, hidden: int) -> None:
        super().__init__()
        self.conv1 = nn.Conv2d(3, 16, 3, stride=4)
        self.conv2 = nn.Conv2d(16, 32, 5, stride=2)
        self.fc = nn.Linear(1152, 128)
        self.lstm = nn.LSTMCell(128 + knowledge, hidden)
        self.actors = nn.ModuleList(nn.Linear(hidden, 7) for _ in range(joints))
        self.critic = nn.Linear(hidden, 1)

    def copy_weights(self, policy: Policy) -> None:
        self.conv1.load_state_dict(policy.encoder.conv1.state_dict())
        self.conv2.load_state_dict(policy.encoder.conv2.state_dict())
        # The policy's features are ordered by position, then channel; Flatten's the other way.
        weight = (
            policy.fc.weight.data.view(128, 36, 32).transpose(1, 2).reshape(128, 1152)
        )
        self.fc.load_state_dict({"weight": weight, "bias": policy.fc.bias.data})
        self.lstm.load_state_dict(policy.memory.state_dict())
        for i, actor in enumerate(self.actors):
            rows = slice(7 * i, 7 * i + 7)
            actor.load_state_dict(
                {
                    "weight": policy.actor.weight.data[rows],
                    "bias": policy.actor.bias.data[rows],
                }
            )
        self.critic.load_state_dict(policy.critic.state_dict())

    def forward(self, image, knowledge, h, c, shift, scale):
        """One step of one environment: image (64, 64, 3) uint8, knowledge (K,), h and c (H,)."""
        x = (image.permute(2, 0, 1)[None].float() / 255 - shift) * scale
        x = torch.relu(self.conv1(x))
        x = torch.relu(self.conv2(x))
        x = torch.relu(self.fc(nn.Flatten()(x)))
        h, c = self.lstm(torch.cat([x, knowledge[None]], 1), (h[None], c[None]))
        logits = torch.stack([actor(h)[0] for actor in self.actors])
        return logits, self.critic(h)[0, 0], h[0], c[0]


def rollout(reference: Reference, image, table, facet, start, state, pixels):
    """Play T steps of every environment by loops; returns logits, values and the last state."""
    h, c = state[0].clone(), state[1].clone()
    logits, values = torch.zeros(T, B, len(reference.actors), 7), torch.zeros(T, B)
    for b in range(B):
        for t in range(T):
            if start[t, b]:
                h[b], c[b] = 0, 0
            logits[t, b], values[t, b], h[b], c[b] = reference(
                image[t, b], table[facet[t, b]], h[b], c[b], *pixels
            )
    return logits, values, (h, c)


@pytest.mark.parametrize("pixels", [(0.0, 1.0), (0.5, 4.0)])
@pytest.mark.parametrize(("joints", "knowledge"), [(6, 0), (6, 150), (7, 300)])
@torch.no_grad()
def test_steps_and_unrolls_equal_plain_layers(joints, knowledge, pixels):
    generator = torch.Generator().manual_seed(4)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator)

    config = PolicyConfig(
        fusion="before_lstm" if knowledge else "none",
        pixel_shift=pixels[0],
        pixel_scale=pixels[1],
        actor_gain=1.0,
    )
    table = normal(FACETS, knowledge)
    policy = Policy(config, PolicyShape(joints=joints, knowledge_dim=knowledge), seed=1)
    for name, parameter in policy.named_parameters():
        if "bias" in name:  # zeros after the initialization would hide them
            parameter.copy_(0.1 * normal(*parameter.shape))
    hidden = 128 + knowledge
    reference = Reference(joints, knowledge, hidden)
    reference.copy_weights(policy)
    image = torch.randint(
        0, 256, (T, B, 64, 64, 3), dtype=torch.uint8, generator=generator
    )
    facet = torch.randint(0, FACETS, (T, B), generator=generator)
    start = torch.rand(T, B, generator=generator) < 0.3
    state = (normal(B, hidden), normal(B, hidden))
    expected = rollout(reference, image, table, facet, start, state, pixels)
    assert expected[0].std() > 0.1
    close = {"rtol": 1e-4, "atol": 1e-4}
    known = table[facet]
    torch.testing.assert_close(
        policy.unroll(image, known, state, start), expected, **close
    )
    for t in range(T):
        logits, values, state = policy.step(image[t], known[t], state, start[t])
        torch.testing.assert_close(logits, expected[0][t], **close)
        torch.testing.assert_close(values, expected[1][t], **close)
    torch.testing.assert_close(state, expected[2], **close)
