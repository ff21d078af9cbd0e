import torch

from knowarm.learn.losses import advantages, n_step_returns, next_values

NONE = torch.zeros(3, 1, dtype=torch.bool)


def column(*values):
    return torch.tensor(values)[:, None]


def test_next_values_are_the_next_rows_but_zero_or_the_final_ones_at_an_end():
    values = torch.tensor([[1.0, 10.0], [2.0, 20.0], [3.0, 30.0]])
    terminated = torch.tensor([[True, False], [False, False], [False, False]])
    truncated = torch.tensor([[False, False], [False, True], [False, False]])
    final = torch.full((3, 2), 7.0)
    result = next_values(
        values, torch.tensor([4.0, 40.0]), final, terminated, truncated
    )
    assert result.tolist() == [[0.0, 20.0], [3.0, 7.0], [4.0, 40.0]]


def test_success_on_the_last_allowed_step_has_no_future():
    both = torch.tensor([[True]])
    result = next_values(column(1.0), torch.tensor([4.0]), column(7.0), both, both)
    assert result.item() == 0.0


def test_n_step_returns_by_hand():
    # R_2 = 3 + .5 * 8 = 7; R_1 = 2 + .5 * 7 = 5.5; R_0 = 1 + .5 * 5.5 = 3.75
    following = column(0.0, 0.0, 8.0)
    result = n_step_returns(column(1.0, 2.0, 3.0), following, NONE, 0.5)
    assert result.flatten().tolist() == [3.75, 5.5, 7.0]


def test_n_step_returns_stop_at_an_episodes_end():
    # The first episode is cut after row 1 with V(final) = 6: R_1 = 2 + .5 * 6 = 5, R_0 = 3.5.
    done = column(False, True, False)
    result = n_step_returns(column(1.0, 2.0, 3.0), column(0.0, 6.0, 8.0), done, 0.5)
    assert result.flatten().tolist() == [3.5, 5.0, 7.0]


def test_advantages_by_hand():
    # deltas: 1 + .5 * 2 - 1 = 1; 2 + .5 * 4 - 2 = 2; 3 + .5 * 8 - 4 = 3; decay .5 * .5 = .25
    result = advantages(
        column(1.0, 2.0, 3.0),
        column(1.0, 2.0, 4.0),
        column(2.0, 4.0, 8.0),
        NONE,
        0.5,
        0.5,
    )
    assert result.flatten().tolist() == [1 + 0.25 * 2.75, 2.75, 3.0]


def test_advantages_do_not_leak_from_the_next_episode():
    done = column(True, False, False)
    result = advantages(
        column(1.0, 2.0, 3.0),
        column(1.0, 2.0, 4.0),
        column(0.0, 4.0, 8.0),
        done,
        0.5,
        0.5,
    )
    assert result[0].item() == 0.0
    assert result[1].item() == 2.75


def test_gae_lambda_one_gives_the_returns_of_the_paper_minus_the_values():
    torch.manual_seed(0)
    rewards, values, last = torch.randn(9, 4), torch.randn(9, 4), torch.randn(4)
    terminated, truncated = torch.rand(9, 4) < 0.2, torch.rand(9, 4) < 0.2
    following = next_values(values, last, torch.randn(9, 4), terminated, truncated)
    done = terminated | truncated
    difference = n_step_returns(rewards, following, done, 0.99) - values
    result = advantages(rewards, values, following, done, 0.99, 1.0)
    torch.testing.assert_close(result, difference)
