import torch

from knowarm.policy.policy import entropy, log_probability, sample


def test_samples_follow_the_softmax():
    logits = torch.log(torch.tensor([[0.5, 0.3, 0.2], [0.1, 0.1, 0.8]])).expand(
        40_000, 2, 3
    )
    drawn = sample(logits, torch.Generator().manual_seed(0))
    share = torch.stack([(drawn == level).float().mean(0) for level in range(3)], 1)
    torch.testing.assert_close(share, logits[0].exp(), atol=0.01, rtol=0)


def test_log_probability_and_entropy_agree_with_pytorchs_categorical():
    torch.manual_seed(0)
    logits, actions = torch.randn(5, 4, 6, 7), torch.randint(0, 7, (5, 4, 6))
    reference = torch.distributions.Categorical(logits=logits)
    torch.testing.assert_close(
        log_probability(logits, actions), reference.log_prob(actions).sum(-1)
    )
    torch.testing.assert_close(entropy(logits), reference.entropy().sum(-1))
