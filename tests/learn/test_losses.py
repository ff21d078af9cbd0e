import math

import pytest
import torch

from knowarm.learn.algorithms import PPOConfig
from knowarm.learn.losses import a3c_loss, distil_loss, ppo_loss

# One joint, two levels, probabilities 3/4 and 1/4.
LOGITS = torch.tensor([[[math.log(3.0), 0.0]], [[math.log(3.0), 0.0]]])
ACTIONS = torch.tensor([[0], [1]])
ENTROPY = -(0.75 * math.log(0.75) + 0.25 * math.log(0.25))


def test_a3c_terms_by_hand():
    terms = a3c_loss(
        LOGITS,
        torch.tensor([1.0, 2.0]),
        ACTIONS,
        torch.tensor([2.0, -4.0]),
        torch.tensor([3.0, 1.0]),
        vf_coef=0.5,
        ent_coef=0.01,
    )
    policy = -(math.log(0.75) * 2 + math.log(0.25) * -4) / 2
    value = 0.5 * (2.0**2 + 1.0**2) / 2
    assert terms["policy_loss"].item() == pytest.approx(policy, rel=1e-6)
    assert terms["value_loss"].item() == pytest.approx(value)
    assert terms["entropy"].item() == pytest.approx(ENTROPY, rel=1e-6)
    assert terms["total"].item() == pytest.approx(
        policy + 0.5 * value - 0.01 * ENTROPY, rel=1e-6
    )


@pytest.mark.parametrize("loss", ["a3c", "ppo"])
def test_descending_the_loss_of_a_worthless_step_raises_the_entropy(loss):
    logits = LOGITS.clone().requires_grad_()
    zeros = torch.zeros(2)
    if loss == "a3c":
        terms = a3c_loss(
            logits, zeros, ACTIONS, zeros, zeros, vf_coef=0.5, ent_coef=0.01
        )
    else:
        old = torch.log(torch.tensor([0.75, 0.25]))
        terms = ppo_loss(
            logits, zeros, ACTIONS, old, zeros, zeros, PPOConfig(ent_coef=0.01)
        )
    terms["total"].backward()
    # Gradient descent lowers the likelier level's logit and lifts the other's.
    assert (logits.grad[:, 0, 0] > 0).all()
    assert (logits.grad[:, 0, 1] < 0).all()


def test_the_probability_of_an_action_is_the_product_over_joints():
    logits = torch.tensor([[[math.log(3.0), 0.0], [0.0, 0.0]]])
    terms = a3c_loss(
        logits,
        torch.zeros(1),
        torch.tensor([[0, 1]]),
        torch.ones(1),
        torch.zeros(1),
        vf_coef=0.0,
        ent_coef=0.0,
    )
    assert terms["total"].item() == pytest.approx(-math.log(0.75 * 0.5), rel=1e-6)
    assert terms["entropy"].item() == pytest.approx(ENTROPY + math.log(2), rel=1e-6)


@pytest.mark.parametrize(
    ("old_probability", "advantage", "factor"),
    [
        (0.72, 2.0, 0.75 / 0.72),  # inside the range: ratio times advantage
        (0.5, 2.0, 1.2),  # nothing is gained beyond it, at ratio 1.5,
        (0.99, -2.0, 0.8),  # nor below it, at ratio .758
        # A good step below it and a bad one beyond are corrected
        (
            0.99,
            2.0,
            0.75 / 0.99,
        ),
        (0.5, -2.0, 1.5),
    ],
)
def test_ppo_by_hand(old_probability, advantage, factor):
    logits, ratio = LOGITS[:1].clone().requires_grad_(), 0.75 / old_probability
    terms = ppo_loss(
        logits,
        torch.tensor([1.0]),
        ACTIONS[:1],
        torch.log(torch.tensor([old_probability])),
        torch.tensor([advantage]),
        torch.tensor([3.0]),
        PPOConfig(clip_range=0.2, vf_coef=0.5, ent_coef=0.0),
    )
    terms["policy_loss"].backward(retain_graph=True)
    assert terms["policy_loss"].item() == pytest.approx(-factor * advantage, rel=1e-6)
    assert terms["value_loss"].item() == pytest.approx(2.0)
    assert terms["clip_fraction"].item() == (abs(ratio - 1) > 0.2)
    assert terms["approx_kl"].item() == pytest.approx(
        ratio - 1 - math.log(ratio), abs=1e-6
    )
    assert (logits.grad.abs().sum() > 0) == (factor == pytest.approx(ratio))


def test_the_loss_of_imitation_is_the_weighted_mean_cross_entropy_per_joint():
    logits = torch.tensor([[[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]]])
    loss = distil_loss(
        logits, torch.tensor([[1, 1]]), torch.tensor([[1.5, 0.5]]), stay_share=0.25
    )
    # Of the second joint's label a quarter is action 0, whose logit is 2.
    expected = (1.5 * math.log(3) + 0.5 * (math.log(math.exp(2) + 2) - 0.25 * 2)) / 2
    assert loss.item() == pytest.approx(expected, rel=1e-6)
