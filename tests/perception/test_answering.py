"""Answer grounding: where the answers of a graph stand, how many are seen, and what a stop is."""

import copy

import numpy as np
import pytest
import torch

from knowarm.experiment.load import load_agent
from knowarm.perception.answering import AnswerGrounding, AnsweringAgent
from knowarm.perception.images import query_answers, sample_images
from knowarm.world.agents.play import play
from knowarm.world.envs.vector_env import ReachVectorEnv
from knowarm.world.tasks.episodes import evaluation_episodes
from tests.experiment.test_zoo import ZOO


@pytest.fixture(scope="module")
def trained():
    return load_agent(ZOO / "irb120-choose-subgraph-fast")


@pytest.fixture(scope="module")
def labels(trained):
    return sample_images(trained.config.env, trained.network.spec, 96, seed=5)


def answers_of(trained):
    return query_answers(trained.config.env, trained.network.spec.facets).satisfies


@torch.no_grad()
def test_the_place_is_the_one_whose_names_answer_best(trained, labels):
    answers, network = answers_of(trained), trained.network
    images, queries = labels.images[:6], labels.queries[:6]
    seen = AnswerGrounding(network, answers).see(images, queries)
    features = network.encoder.features(images)
    objects, colours = network.encoder.logits(features)
    for row, query in enumerate(queries.tolist()):
        total = torch.zeros(objects.shape[2], dtype=torch.float64)
        for facet in answers[query].nonzero().flatten().tolist():
            o, c = network.encoder.facet_parts[:, facet].tolist()
            total += (objects[row, o] + colours[row, c]).double().exp()
        torch.testing.assert_close(seen.scores[row].double(), total.log(), rtol=1e-4, atol=1e-4)
        place = total.argmax().view(1, 1)
        expected = network.frames(features[row, None], place)[0, 0]
        torch.testing.assert_close(seen.frames[row], expected)


@torch.no_grad()
def test_the_number_of_visible_answers_is_that_of_the_image(trained, labels):
    """Of one query, of none and of all facets; each image shows four objects."""
    answers = answers_of(trained).float()
    none, every = torch.zeros(1, answers.shape[1]), torch.ones(1, answers.shape[1])
    module = AnswerGrounding(trained.network, torch.cat((answers, none, every)))
    first = torch.zeros_like(labels.queries)
    for queries, count in ((labels.queries, 1), (first + len(answers), 0), (first - 1, 4)):
        seen = module.see(labels.images, queries % len(module.knowledge))
        assert (seen.visible == count).float().mean() > 0.85
        assert seen.frames.isfinite().all()
    named = (seen.named[:, :, None] == labels.facets[:, None]).any(1)
    assert named.float().mean() > 0.9
    assert all(len(set(row)) == 4 for row in seen.places.tolist())


def test_a_copy_keeps_answers_and_weights(trained, labels):
    module = AnswerGrounding(trained.network, answers_of(trained))
    again = copy.deepcopy(module)
    assert again.to_bytes() == module.to_bytes() == trained.network.to_bytes()
    with torch.no_grad():
        found = [each(labels.images, labels.queries) for each in (module, again)]
    assert torch.equal(*found)


def test_an_agent_that_sees_no_answer_stays_or_guesses(trained):
    env = ReachVectorEnv(trained.config.env, 4)
    episodes = evaluation_episodes(env.config, 4, 0)
    nothing = np.zeros(answers_of(trained).shape, bool)
    moved = {}
    for unclear in ("stop", "guess"):
        agent = trained.answering(nothing, unclear)
        assert isinstance(agent, AnsweringAgent)
        result = play(agent, env, episodes)
        assert (agent.visible_answers == 0).all()
        assert [len(part) for part in agent.log] == [4]
        moved[unclear] = (result.steps.actions != 0).any()
    assert moved == {"stop": False, "guess": True}


@torch.no_grad()
def test_a_zeroed_query_is_a_guess_and_a_swapped_one_leads_to_the_other_object(trained):
    """Vectors and answers of the shipped network, on 400 images: chance is 25 %."""
    env, network = trained.config.env, trained.network
    labels = sample_images(env, network.spec, 400, seed=9)
    table, rows = query_answers(env, network.spec.facets), torch.arange(400)
    satisfied = table.satisfies[:, labels.facets].permute(1, 0, 2)  # (N, Q, m)
    for_second = (satisfied.sum(2) == 1) & satisfied[..., 1]
    for_second &= table.askable[:, labels.facets[:, 1]].T
    assert for_second.any(1).all()
    other = for_second.float().argmax(1)

    def nearest(frames):
        position = frames[:, :3] * network.position_std + network.position_mean
        return (labels.grasp_position - position[:, None]).norm(dim=2).argmin(1)

    vectors = network.knowledge
    by_answers = AnswerGrounding(network, table.satisfies)
    for module, knowledge in ((network, vectors), (by_answers, by_answers.knowledge)):
        assert (nearest(module(labels.images, labels.queries)) == 0).float().mean() > 0.93
        assert (nearest(module(labels.images, other)) == 1).float().mean() > 0.93
        swapped = knowledge[other]
        module.knowledge = swapped
        assert (nearest(module(labels.images, rows)) == 1).float().mean() > 0.93
        module.knowledge = torch.zeros_like(swapped)
        assert 0.18 < (nearest(module(labels.images, rows)) == 0).float().mean() < 0.32
        module.knowledge = knowledge
