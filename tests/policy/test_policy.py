import pickle

import numpy as np
import pytest
import torch
from torch import nn

from knowarm.errors import UserError
from knowarm.policy import Policy, PolicyAgent, PolicyConfig, PolicyShape
from knowarm.policy.config import FUSIONS, hidden_size
from knowarm.policy.encoder import ImageEncoder
from knowarm.policy.fusion import Fusion, Similarity

T, B, K, FACETS = 4, 3, 12, 5
SHAPE = {
    "joints": 2,
    "levels": 3,
    "image_size": 28,
    "knowledge_dim": K,
    "knowledge_slots": 3,
}
TABLE = np.random.default_rng(7).standard_normal((FACETS, K)).astype(np.float32)


def make_policy(fusion, *, seed=0, **changes):
    """Create a small policy; ``changes`` go to the shape or to the config, by name."""
    shape = {name: changes.pop(name, value) for name, value in SHAPE.items()}
    config = PolicyConfig(features=16, fusion=fusion, **changes)
    return Policy(config, PolicyShape(**shape), seed=seed)


def inputs(seed=0):
    generator = torch.Generator().manual_seed(seed)
    image = torch.randint(
        0, 256, (T, B, 28, 28, 3), dtype=torch.uint8, generator=generator
    )
    facet = torch.randint(0, FACETS, (T, B), generator=generator)
    start = torch.rand(T, B, generator=generator) < 0.3
    return image, torch.from_numpy(TABLE)[facet], start


@pytest.mark.parametrize(
    ("knowledge", "hidden", "size", "memory"),
    [
        (0, "grow", 128, 132_096),
        (150, "grow", 278, 620_496),
        (300, "grow", 428, 1_468_896),
        (150, "fixed", 128, 208_896),
        (300, "fixed", 128, 285_696),
    ],
)
def test_sizes_of_the_paper(knowledge, hidden, size, memory):
    config = PolicyConfig(hidden=hidden, fusion="before_lstm" if knowledge else "none")
    shape = PolicyShape(joints=6, knowledge_dim=knowledge)
    policy = Policy(config, shape)
    assert policy.encoder.width == 1152
    assert policy.hidden_size == hidden_size(config, shape) == size
    counts = policy.parameter_counts()
    assert counts["memory"] == memory
    assert counts["image"] == 3 * 9 * 16 + 16 + 16 * 25 * 32 + 32 + 1152 * 128 + 128
    assert counts["total"] == sum(p.numel() for p in policy.parameters())


@pytest.mark.parametrize("fusion", FUSIONS)
def test_shapes_and_steps_agree_with_the_unroll(fusion):
    policy = make_policy(fusion, seed=1)
    image, knowledge, start = inputs()
    state = policy.initial_state(B)
    logits, values, last = policy.unroll(image, knowledge, state, start)
    assert logits.shape == (T, B, 2, 3)
    assert values.shape == (T, B)
    for t in range(T):
        one, value, state = policy.step(image[t], knowledge[t], state, start[t])
        torch.testing.assert_close(one, logits[t])
        torch.testing.assert_close(value, values[t])
    torch.testing.assert_close(state, last)


@pytest.mark.parametrize("fusion", FUSIONS)
def test_every_live_parameter_gets_a_gradient(fusion):
    policy = make_policy(fusion, knowledge_encoder="learned", actor_gain=1.0)
    image, knowledge, start = inputs()
    logits, values, _ = policy.unroll(image, knowledge, policy.initial_state(B), start)
    (logits.square().sum() + values.square().sum()).backward()
    for name, parameter in policy.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().sum() > 0, name


@pytest.mark.parametrize("fusion", ["before_lstm", "none"])
def test_bfloat16_products_give_nearly_the_same_numbers_and_gradients(fusion):
    image, knowledge, start = inputs()
    results = {}
    for precision in ("float32", "bfloat16"):
        policy = make_policy(fusion, pixel_shift=0.5, actor_gain=1.0, seed=1)
        policy.matmul_precision = precision
        state = policy.initial_state(B)
        logits, values, last = policy.unroll(image, knowledge, state, start)
        one, _, _ = policy.step(image[0], knowledge[0], state, start[0])
        torch.testing.assert_close(one, logits[0], atol=2e-2, rtol=0)
        assert logits.dtype == values.dtype == last[0].dtype == torch.float32
        (logits.square().sum() + values.square().sum()).backward()
        gradient = torch.cat([p.grad.flatten() for p in policy.parameters()])
        results[precision] = logits.detach(), values.detach(), gradient
    for exact, low in zip(*results.values(), strict=True):
        assert not torch.equal(exact, low)
        similarity = torch.cosine_similarity(exact.flatten(), low.flatten(), dim=0)
        assert similarity > 0.999


@pytest.mark.parametrize("fusion", FUSIONS)
def test_knowledge_reaches_what_the_fusion_promises(fusion):
    policy = make_policy(fusion, actor_gain=1.0)
    image, knowledge, start = inputs()
    state = policy.initial_state(B)
    logits, values, _ = policy.unroll(image, knowledge, state, start)
    other_logits, other_values, _ = policy.unroll(image, knowledge + 1, state, start)
    assert torch.allclose(values, other_values) == (fusion == "none")
    assert torch.allclose(logits, other_logits) == (fusion in ("none", "critic"))


@torch.no_grad()
def test_similarity_amplifies_positions_that_match_all_slots():
    """Channel 0 answers the first slot, channel 1 the second; one position of nine has both."""
    fusion = Similarity(16, 6, 2)
    fusion.key = nn.Identity()
    fusion.query = nn.Linear(3, ImageEncoder.channels, bias=False)
    fusion.query.weight.zero_()
    fusion.query.weight[0, 0] = fusion.query.weight[1, 1] = 30.0
    maps = torch.zeros(1, 9, ImageEncoder.channels)
    maps[:, 3:6, 0] = maps[:, 5:, 1] = 1.0
    maps[..., 2] = 1.0
    both = torch.tensor([[1.0, 0, 0, 0, 1.0, 0]])
    weighted = fusion("fc", maps.flatten(1), both).view(9, -1)[:, 2]
    assert weighted.argmax() == 5
    assert weighted.mean() == pytest.approx(1.0)
    assert weighted.min() >= 0.5
    first = fusion("fc", maps.flatten(1), both * torch.tensor([1, 1, 1, 0, 0, 0])).view(
        9, -1
    )
    assert (first[3:6, 2] > 1).all()
    assert (first[[0, 1, 2, 6, 7, 8], 2] < 1).all()
    assert torch.equal(fusion("fc", maps.flatten(1), 0 * both), maps.flatten(1))
    assert fusion("lstm", maps, both) is maps


@pytest.mark.parametrize("fusion", ["none", "before_lstm"])
def test_patches_and_images_give_the_same_numbers(fusion):
    policy = make_policy(fusion, seed=1)
    image, knowledge, start = inputs()
    state = policy.initial_state(B)
    patches = policy.patches(image)
    assert patches.shape == (T, B, *policy.encoder.patch_shape)
    for got, expected in zip(
        policy.unroll(patches, knowledge, state, start)[:2],
        policy.unroll(image, knowledge, state, start)[:2],
        strict=True,
    ):
        assert torch.equal(got, expected)
    one = policy.step(patches[0], knowledge[0], state, start[0])[0]
    assert torch.equal(one, policy.step(image[0], knowledge[0], state, start[0])[0])


def test_knowledge_of_another_width_or_dtype_is_rejected():
    policy = make_policy("before_lstm")
    policy.check_knowledge(torch.zeros(2, K))
    for wrong in (
        torch.zeros(2, K - 1),
        torch.zeros(2, K, dtype=torch.int64),
        torch.zeros(2),
    ):
        with pytest.raises(
            UserError, match="the policy expects vectors of 12 float32 numbers"
        ):
            policy.check_knowledge(wrong)
    make_policy("none").check_knowledge(torch.zeros(2, 0))


def test_a_maker_builds_the_same_structure():
    policy = make_policy("attention", seed=4, knowledge_encoder="learned", wide=False)
    built = pickle.loads(pickle.dumps(policy.maker()))()
    built.load_state_dict(policy.state_dict())
    image, knowledge, start = inputs()
    state = policy.initial_state(B)
    expected = policy.unroll(image, knowledge, state, start)[0]
    assert torch.equal(built.unroll(image, knowledge, state, start)[0], expected)


def test_pixels_are_scaled_and_shifted():
    policy = make_policy("none", pixel_shift=0.5, pixel_scale=3.0)
    image = inputs()[0][0]
    pixels = image.permute(0, 3, 1, 2).float() / 255
    pixels = 3 * (pixels - 0.5)
    expected = policy.encoder.conv2(torch.relu(policy.encoder.conv1(pixels))).relu()
    expected = expected.permute(0, 2, 3, 1).flatten(1)
    torch.testing.assert_close(policy.encoder(policy.patches(image)), expected)


def test_weights_are_orthogonal_and_come_from_the_seed():
    first, again, other = (make_policy("before_lstm", seed=s) for s in (1, 1, 2))
    assert torch.equal(first.memory.weight_hh, again.memory.weight_hh)
    assert not torch.equal(first.memory.weight_hh, other.memory.weight_hh)
    gram = first.memory.weight_hh.T @ first.memory.weight_hh
    torch.testing.assert_close(gram, torch.eye(len(gram)), atol=1e-5, rtol=0)
    for head in first.actor.weight.split(3):
        torch.testing.assert_close(
            head @ head.T, 1e-4 * torch.eye(3), atol=1e-7, rtol=0
        )


@pytest.mark.parametrize("joints", [6, 7])
@pytest.mark.parametrize("knowledge", [50, 150, 300])
def test_the_capacity_control_has_the_same_encoder_and_as_many_parameters(
    joints, knowledge
):
    shape = PolicyShape(joints=joints, knowledge_dim=knowledge)
    informed, control = (
        Policy(PolicyConfig(wide=wide), shape) for wide in (False, True)
    )
    assert control.config.wide
    assert not control.resolved_config.wide
    assert control.resolved_config.fusion == "none"
    assert control.resolved_config.features == 128
    counts, others = informed.parameter_counts(), control.parameter_counts()
    assert others["image"] == counts["image"]
    assert abs(others["total"] / counts["total"] - 1) < 0.002
    assert Policy(control.resolved_config, shape).parameter_counts() == others


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"knowledge_dim": 0}, "fusion 'before_lstm' needs"),
        ({"knowledge_slots": 5}, "must divide"),
        ({"hidden": 0}, "hidden"),
        ({"image_size": 8}, "image_size"),
        ({"joints": 0}, "joints"),
    ],
)
def test_invalid_sizes_are_rejected(changes, message):
    with pytest.raises(UserError, match=message):
        make_policy("before_lstm", **changes)


class Still:
    """Stands in for a batch: three episodes of facets 0, 1, 1."""

    rows = np.array([0, 1, 1])


def test_the_agent_remembers_until_the_next_start_and_reads_its_facets_row():
    policy = make_policy("before_lstm", actor_gain=50.0, seed=3)
    image = inputs()[0].numpy()
    agent = PolicyAgent(policy, TABLE, greedy=True)
    agent.reset(Still())
    acted = [agent.act({"image": image[t]}) for t in range(T)]
    logits, _, _ = policy.unroll(
        torch.from_numpy(image),
        torch.from_numpy(TABLE)[[0, 1, 1]].expand(T, B, K),
        policy.initial_state(B),
        torch.zeros(T, B, dtype=torch.bool),
    )
    np.testing.assert_array_equal(np.stack(acted), logits.argmax(-1).numpy())
    agent.reset(Still())
    np.testing.assert_array_equal(agent.act({"image": image[0]}), acted[0])


def test_sampled_actions_come_from_the_generator():
    policy = make_policy("none")
    image = inputs()[0].numpy()

    def draw(seed):
        generator = torch.Generator().manual_seed(seed)
        agent = PolicyAgent(policy, greedy=False, generator=generator)
        agent.reset(Still())
        return np.stack([agent.act({"image": image[0]}) for _ in range(8)])

    np.testing.assert_array_equal(draw(1), draw(1))
    assert (draw(1) != draw(2)).any()


def test_an_unknown_fusion_is_rejected_with_the_nearest_names():
    with pytest.raises(UserError, match=r"Unknown fusion 'filn'\. Did you mean 'film'"):
        PolicyConfig(fusion="filn")


def test_a_fusion_is_one_class_and_one_entry(monkeypatch):
    class Doubled(Fusion):
        """Knowledge twice before the LSTM."""

        def extra_inputs(self, layer):
            return 2 * self.knowledge if layer == "lstm" else 0

        def forward(self, layer, x, knowledge):
            return torch.cat((x, knowledge, knowledge), 1) if layer == "lstm" else x

    monkeypatch.setitem(FUSIONS, "doubled", Doubled)
    policy = make_policy("doubled")
    image, knowledge, start = inputs()
    logits, _, _ = policy.unroll(image, knowledge, policy.initial_state(B), start)
    assert logits.shape == (T, B, 2, 3)
    assert policy.memory.weight_ih.shape[1] == 16 + 2 * K


@pytest.mark.parametrize("activation", ["relu", "none"])
def test_the_activation_after_the_fully_connected_layer(activation):
    policy = make_policy("none", fc_activation=activation)
    patches = policy.patches(inputs()[0][0])
    features = policy._features(patches, torch.zeros(B, 0))
    plain = policy.fc(policy.encoder(patches))
    assert (plain < 0).any()
    assert torch.equal(features, plain.clamp(min=0) if activation == "relu" else plain)
    gain = 2.0 if activation == "relu" else 1.0
    product = policy.fc.weight @ policy.fc.weight.T
    torch.testing.assert_close(product, gain * torch.eye(16), rtol=0, atol=1e-5)
