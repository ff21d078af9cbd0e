import numpy as np
import pytest
import torch

from knowarm.errors import UserError
from knowarm.policy import Policy, PolicyAgent, PolicyConfig, matched_without_knowledge
from knowarm.policy.fusion import FUSIONS

T, B, K = 4, 3, 12
USED = [name for name in FUSIONS if name != "none"]


def config(fusion, **changes):
    sizes = {"joints": 2, "levels": 3, "image_size": 24, "features": 16, "knowledge_dim": K}
    return PolicyConfig(**{**sizes, "fusion": fusion, "knowledge_slots": 3, **changes})


def inputs(seed=0):
    generator = torch.Generator().manual_seed(seed)
    image = torch.randint(0, 256, (T, B, 24, 24, 3), dtype=torch.uint8, generator=generator)
    knowledge = torch.randn(T, B, K, generator=generator)
    start = torch.rand(T, B, generator=generator) < 0.3
    return image, knowledge, start


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
    made = PolicyConfig(
        joints=6,
        knowledge_dim=knowledge,
        hidden=hidden,
        fusion="before_lstm" if knowledge else "none",
    )
    policy = Policy(made)
    assert policy.encoder.width == 1152
    assert made.hidden_size == size
    counts = policy.parameter_counts()
    assert counts["memory"] == memory
    assert counts["image"] == 3 * 9 * 16 + 16 + 16 * 25 * 32 + 32 + 1152 * 128 + 128
    assert counts["total"] == sum(p.numel() for p in policy.parameters())


@pytest.mark.parametrize("fusion", FUSIONS)
def test_shapes_and_steps_agree_with_the_unroll(fusion):
    policy = Policy(config(fusion), seed=1)
    image, knowledge, start = inputs()
    state = policy.initial_state(B)
    logits, values, last = policy.unroll(policy.patches(image), knowledge, state, start)
    assert logits.shape == (T, B, 2, 3)
    assert values.shape == (T, B)
    for t in range(T):
        one, value, state = policy.step(policy.patches(image[t]), knowledge[t], state, start[t])
        torch.testing.assert_close(one, logits[t])
        torch.testing.assert_close(value, values[t])
    torch.testing.assert_close(state, last)


@pytest.mark.parametrize("fusion", FUSIONS)
def test_every_live_parameter_gets_a_gradient(fusion):
    policy = Policy(config(fusion, knowledge_encoder="learned", actor_gain=1.0))
    image, knowledge, start = inputs()
    logits, values, _ = policy.unroll(
        policy.patches(image), knowledge, policy.initial_state(B), start
    )
    (logits.square().sum() + values.square().sum()).backward()
    for name, parameter in policy.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().sum() > 0, name


@pytest.mark.parametrize("fusion", ["before_lstm", "none"])
def test_bfloat16_products_give_nearly_the_same_numbers_and_gradients(fusion):
    image, knowledge, start = inputs()
    results = {}
    for precision in ("float32", "bfloat16"):
        policy = Policy(config(fusion, pixel_shift=0.5, actor_gain=1.0), seed=1)
        policy.matmul_precision = precision
        state = policy.initial_state(B)
        logits, values, last = policy.unroll(policy.patches(image), knowledge, state, start)
        one, _, _ = policy.step(policy.patches(image[0]), knowledge[0], state, start[0])
        torch.testing.assert_close(one, logits[0], atol=2e-2, rtol=0)
        assert logits.dtype == values.dtype == last[0].dtype == torch.float32
        (logits.square().sum() + values.square().sum()).backward()
        gradient = torch.cat([p.grad.flatten() for p in policy.parameters()])
        results[precision] = logits.detach(), values.detach(), gradient
    for exact, low in zip(*results.values(), strict=True):
        assert not torch.equal(exact, low)
        similarity = torch.cosine_similarity(exact.flatten(), low.flatten(), dim=0)
        assert similarity > 0.999


@pytest.mark.parametrize("fusion", USED)
def test_knowledge_reaches_what_the_fusion_promises(fusion):
    policy = Policy(config(fusion, actor_gain=1.0))
    image, knowledge, start = inputs()
    state = policy.initial_state(B)
    logits, values, _ = policy.unroll(policy.patches(image), knowledge, state, start)
    other_logits, other_values, _ = policy.unroll(
        policy.patches(image), knowledge + 1, state, start
    )
    assert not torch.allclose(values, other_values)
    assert torch.allclose(logits, other_logits) == (fusion == "critic")


def test_without_fusion_knowledge_changes_nothing():
    policy = Policy(config("none"))
    image, knowledge, start = inputs()
    state = policy.initial_state(B)
    first = policy.unroll(policy.patches(image), knowledge, state, start)[0]
    assert torch.equal(first, policy.unroll(policy.patches(image), knowledge + 1, state, start)[0])


def test_pixels_are_scaled_and_shifted():
    policy = Policy(config("none", pixel_shift=0.5, pixel_scale=3.0))
    image = inputs()[0][0]
    pixels = image.permute(0, 3, 1, 2).float() / 255
    pixels = 3 * (pixels - 0.5)
    expected = policy.encoder.conv2(torch.relu(policy.encoder.conv1(pixels))).relu()
    expected = expected.permute(0, 2, 3, 1).flatten(1)
    torch.testing.assert_close(policy.encoder(policy.patches(image)), expected)


def test_weights_are_orthogonal_and_come_from_the_seed():
    first, again, other = (Policy(config("before_lstm"), seed=s) for s in (1, 1, 2))
    assert torch.equal(first.memory.weight_hh, again.memory.weight_hh)
    assert not torch.equal(first.memory.weight_hh, other.memory.weight_hh)
    gram = first.memory.weight_hh.T @ first.memory.weight_hh
    torch.testing.assert_close(gram, torch.eye(len(gram)), atol=1e-5, rtol=0)
    for head in first.actor.weight.split(3):
        torch.testing.assert_close(head @ head.T, 1e-4 * torch.eye(3), atol=1e-7, rtol=0)


def test_the_capacity_control_matches_size_and_count():
    with_knowledge = PolicyConfig(joints=6, knowledge_dim=150)
    without = matched_without_knowledge(with_knowledge)
    assert without.fusion == "none"
    assert without.hidden_size == 278
    counts = [Policy(c).parameter_counts()["total"] for c in (with_knowledge, without)]
    assert abs(counts[1] / counts[0] - 1) < 0.002


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
def test_bad_sizes_are_refused(changes, message):
    with pytest.raises(UserError, match=message):
        config("before_lstm", **changes)


class Still:
    """Stands in for a vector environment: three running episodes of facets 0, 1, 1."""

    num_envs = B
    facet_ids = np.array([0, 1, 1])


def test_the_agent_remembers_until_the_next_start_and_reads_its_facets_row():
    policy = Policy(config("before_lstm", actor_gain=50.0), seed=3)
    table = np.random.default_rng(0).standard_normal((2, K)).astype(np.float32)
    image = inputs()[0].numpy()
    agent = PolicyAgent(policy, table, greedy=True)
    agent.start(Still())
    acted = [agent.act(image[t]) for t in range(T)]
    logits, _, _ = policy.unroll(
        policy.patches(torch.from_numpy(image)),
        torch.from_numpy(table)[[0, 1, 1]].expand(T, B, K),
        policy.initial_state(B),
        torch.zeros(T, B, dtype=torch.bool),
    )
    np.testing.assert_array_equal(np.stack(acted), logits.argmax(-1).numpy())
    agent.start(Still())
    np.testing.assert_array_equal(agent.act(image[0]), acted[0])


def test_sampled_actions_come_from_the_generator():
    policy = Policy(config("none"))
    image = inputs()[0].numpy()

    def draw(seed):
        generator = torch.Generator().manual_seed(seed)
        agent = PolicyAgent(policy, np.zeros((2, K)), greedy=False, generator=generator)
        agent.start(Still())
        return np.stack([agent.act(image[0]) for _ in range(8)])

    np.testing.assert_array_equal(draw(1), draw(1))
    assert (draw(1) != draw(2)).any()
