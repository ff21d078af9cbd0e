"""The network that reads facts: what it must ignore, and that it learns to reason."""

import torch

from knowarm.perception.facts import FactEncoder
from knowarm.questions import FACTS

D, NAMES = 16, 80


def encoder(width=16, seed=0):
    torch.manual_seed(seed)
    return FactEncoder(FACTS * 3 * D, width)


def slots(words, queries, facts):
    """Return slots (n, FACTS * 3 D): what is asked, (n, 2), and facts (n, m, 3), by number."""
    rows = torch.zeros(len(queries), FACTS, 3, D)
    rows[:, 0, 1:] = words[queries]
    rows[:, 1 : 1 + facts.shape[1]] = words[facts]
    return rows.flatten(1)


def test_the_order_of_facts_and_rows_without_a_fact_do_not_matter():
    generator = torch.Generator().manual_seed(0)
    words = torch.randn(NAMES, D, generator=generator)
    query, facts = torch.tensor([[3, 7]]), torch.randint(0, NAMES, (1, 5, 3), generator=generator)
    read, given = encoder(), slots(words, query, facts)
    found = read(given)
    assert found.shape == (1, 16)
    torch.testing.assert_close(read(slots(words, query, facts[:, [4, 2, 0, 1, 3]])), found)
    gap = given.unflatten(1, (FACTS, -1)).clone()
    gap[:, [3, 20]] = gap[:, [20, 3]]  # row 20 has no fact
    torch.testing.assert_close(read(gap.flatten(1)), found)
    assert not torch.allclose(read(slots(words, query, facts[:, :4])), found)
    assert not torch.allclose(read(slots(words, query + 1, facts)), found)


def test_it_learns_to_sum_the_answers_to_queries_that_training_never_had():
    """Heads of the facts whose relation is asked for; each batch has relations of its own."""
    generator = torch.Generator().manual_seed(1)
    heads = torch.nn.functional.normalize(torch.randn(20, D, generator=generator), dim=1)

    def draw(count):
        relations = torch.randn(NAMES - 20, D, generator=generator)
        words = torch.cat((heads, torch.nn.functional.normalize(relations, dim=1)))
        asked = torch.randint(20, NAMES, (count, 2), generator=generator)
        facts = torch.randint(0, 20, (count, 6, 3), generator=generator)
        facts[..., 1] = torch.randint(20, NAMES, (count, 6), generator=generator)
        facts[:, ::2, 1] = asked[:, :1]
        answers = (facts[..., 1] == asked[:, :1])[..., None] * words[facts[..., 0]]
        return slots(words, asked, facts), answers.sum(1)

    read = encoder(width=D)
    optimizer = torch.optim.Adam(read.parameters(), lr=3e-3)
    for _ in range(400):
        given, wanted = draw(64)
        loss = (read(given) - wanted).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    given, wanted = draw(500)
    with torch.no_grad():
        error = (read(given) - wanted).square().mean()
    assert error < 0.5 * wanted.var()
