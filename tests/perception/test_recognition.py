"""Answer grounding: where the answers of a graph stand, how many are seen, and what a stop is."""

import numpy as np
import pytest
import torch

from knowarm.perception.config import GroundingConfig, GroundingSpec
from knowarm.perception.grounding import GroundingNetwork, place_of
from knowarm.perception.images import query_answers, sample_images
from knowarm.perception.recognition import (
    AnswerGrounding,
    AnsweringAgent,
    FrameRecognition,
)
from knowarm.questions import object_of
from knowarm.world.agents.play import play
from knowarm.world.config import EnvConfig, questions_of
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.objects import PARTS
from knowarm.world.tasks.asked.part.part import AskPart
from knowarm.world.tasks.asked.query.query_source import NameQueries


@pytest.fixture(scope="module")
def parted():
    """Return a task with two parts per object, and an untrained network for it."""
    names = tuple(
        name for name in PARTS if object_of(name) in ("bell", "globe", "brush")
    )
    task = AskPart(queries=NameQueries())
    env = EnvConfig(task=task, targets=names, dynamics="kinematic")
    knowledge = np.random.default_rng(0).normal(
        size=(len(questions_of(env).queries), 6)
    )
    spec = GroundingSpec.of(env, GroundingConfig())
    return env, GroundingNetwork(spec, knowledge.astype(np.float32), 1)


@pytest.fixture(scope="module")
def labels(trained):
    return sample_images(trained.config.env, trained.network.spec, 96, seed=5)


def answers_of(trained):
    return query_answers(trained.config.env, trained.network.spec.facets).satisfies


@torch.no_grad()
def test_a_policy_in_training_is_given_the_frames_alone(trained, labels, monkeypatch):
    answering = AnswerGrounding(trained.network, answers_of(trained))
    images, queries = labels.images[:4], labels.queries[:4]
    frames = answering.see(images, answering.of_rows(queries)).frames
    monkeypatch.setattr(answering, "name", None)  # names serve evaluations only
    torch.testing.assert_close(answering(images, queries), frames, rtol=0, atol=0)


@torch.no_grad()
def test_the_place_is_the_one_whose_names_answer_best(trained, labels):
    answers, network = answers_of(trained), trained.network
    images, queries = labels.images[:6], labels.queries[:6]
    seen = AnswerGrounding(network, answers).see(images, answers[queries].float())
    features = network.encoder.features(images)
    objects, colours = network.encoder.logits(features)
    for row, query in enumerate(queries.tolist()):
        total = torch.zeros(objects.shape[2], dtype=torch.float64)
        for facet in answers[query].nonzero().flatten().tolist():
            o, c = network.encoder.facet_parts[:, facet].tolist()
            total += (objects[row, o] + colours[row, c]).double().exp()
        torch.testing.assert_close(
            seen.scores[row].double(), total.log(), rtol=1e-4, atol=1e-4
        )
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
    for queries, count in (
        (labels.queries, 1),
        (first + len(answers), 0),
        (first - 1, 4),
    ):
        seen = module.see(
            labels.images, module.knowledge[queries % len(module.knowledge)]
        )
        assert (seen.visible == count).float().mean() > 0.85
        assert seen.frames.isfinite().all()
    named = (seen.named[:, :, None] == labels.facets[:, None]).any(1)
    assert named.float().mean() > 0.9
    assert all(len(set(row)) == 4 for row in seen.places.tolist())


@torch.no_grad()
def test_an_answer_is_a_part_at_a_place(parted):
    """An untrained network: each part has its own frame, and all parts of an object are named."""
    network = parted[1]
    facets = network.spec.facets
    images = sample_images(parted[0], network.spec, 3, seed=2).images
    knob, handle = (
        facets.index(("bell.knob", "red")),
        facets.index(("bell.handle", "red")),
    )
    answers = torch.zeros(2, len(facets))
    answers[0, knob] = answers[1, handle] = 1
    module = AnswerGrounding(network, answers)
    features = network.encoder.features(images)
    for query, facet in enumerate((knob, handle)):
        seen = module.see(images, module.of_rows(torch.full((3,), query)))
        cell = seen.scores.argmax(1) * 2 + (facet == max(knob, handle))
        expected = network.frames(features, cell[:, None])[:, 0]
        torch.testing.assert_close(seen.frames, expected)
        other = network.frames(features, cell[:, None] ^ 1)[:, 0]
        assert ((seen.frames - other).abs().amax(1) > 1e-4).all()
    for named, places in zip(seen.named.tolist(), seen.places.tolist(), strict=True):
        shown = [
            (object_of(name), colour)
            for name, colour in (facets[each] for each in named)
        ]
        assert len(set(named)) == 4
        assert (shown[0], shown[2]) == (shown[1], shown[3])
        assert shown[0][0] != shown[2][0]
        assert places[0] == places[1] != places[2] == places[3]


@torch.no_grad()
def test_a_query_selects_a_part_at_a_place(parted):
    env, network = parted
    labels = sample_images(env, network.spec, 8, seed=1)
    features, rows = network.encoder.features(labels.images), torch.arange(8)
    keys = network.keys(features)
    query = network.project_queries(network.knowledge[labels.queries])
    cell = (keys * query[:, None]).sum(2).argmax(1)
    assert keys.shape == (8, 2 * 256, 64)
    assert {0, 1} == set((cell % 2).tolist())
    frames = network.frames(features, cell[:, None])[:, 0]
    torch.testing.assert_close(
        FrameRecognition(network)(labels.images, labels.queries), frames
    )
    place = place_of(labels.pixels[:, 0], 64)
    part = network.part_of[labels.facets[:, 0]]
    asked = query_answers(env, network.spec.facets)
    wanted = keys[rows, place * 2 + part] * query
    likelihood = wanted.sum(1) - (keys * query[:, None]).sum(2).logsumexp(1)
    for row in range(8):
        one = rows[row : row + 1]
        query = labels.queries[one]
        loss = network.place_loss(
            features[one], labels.of(one), network.knowledge[query], asked.of(query)
        )
        torch.testing.assert_close(loss, -likelihood[row], rtol=1e-4, atol=1e-4)


def test_an_agent_that_sees_no_answer_stays_or_guesses(trained):
    env = ArmVectorEnv(trained.config.env, 4)
    episodes = evaluation_episodes(env.config, 4, 0)
    nothing = np.zeros(answers_of(trained).shape, bool)
    moved = {}
    for unclear in ("stop", "seen", "ask", "guess"):
        agent = trained.answering(nothing, unclear=unclear)
        assert isinstance(agent, AnsweringAgent)
        result = play(agent, env, episodes)
        assert (agent.visible_answers == 0).all()
        assert len(agent.notes["candidates"]) == 4  # of these episodes alone
        assert (result.notes["candidates"] == agent.notes["candidates"]).all()
        moved[unclear] = (result.steps.actions != 0).any()
    assert moved == {"stop": False, "seen": False, "ask": False, "guess": True}


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

    for kind, knowledge in (
        (FrameRecognition, network.knowledge),
        (AnswerGrounding, table.satisfies.float()),
    ):
        own, swapped = kind(network, knowledge), kind(network, knowledge[other])
        zeros = kind(network, torch.zeros_like(knowledge[other]))
        assert (nearest(own(labels.images, labels.queries)) == 0).float().mean() > 0.93
        assert (nearest(own(labels.images, other)) == 1).float().mean() > 0.93
        assert (nearest(swapped(labels.images, rows)) == 1).float().mean() > 0.93
        assert 0.18 < (nearest(zeros(labels.images, rows)) == 0).float().mean() < 0.32


def test_of_two_visible_answers_the_surer_one_is_found(trained, labels):
    network, rows = trained.network, torch.arange(len(labels.images))
    both = torch.zeros(len(rows), len(network.spec.facets))
    both[rows, labels.facets[:, 0]] = both[rows, labels.facets[:, 1]] = 1.0

    def nearest(first, second):
        known = both.clone()
        known[rows, labels.facets[:, 0]], known[rows, labels.facets[:, 1]] = (
            first,
            second,
        )
        seen = AnswerGrounding(network, known).see(labels.images, known)
        position = seen.frames[:, :3] * network.position_std + network.position_mean
        return (labels.grasp_position - position[:, None]).norm(dim=2).argmin(1), seen

    (first, seen), (second, _), (either, _) = (
        nearest(1, 1e-4),
        nearest(1e-4, 1),
        nearest(1, 1),
    )
    assert (first == 0).float().mean() > 0.9
    assert (second == 1).float().mean() > 0.9
    assert (either == 0).float().mean() < 0.8
    torch.testing.assert_close(nearest(0.3, 0.3)[0], either)  # alike: as if certain
    assert (seen.visible == 1).float().mean() > 0.9


@torch.no_grad()
def test_a_doubtful_fact_makes_the_same_candidates_as_a_certain_one(trained, labels):
    """From one half on: how probable a fact is decides among answers, not whether one is seen."""
    network = trained.network
    count = len(network.spec.facets)
    thresholds = torch.full((count,), 0.6)
    certain = torch.nn.functional.one_hot(labels.facets[:, 0], count).float()
    candidates = {}
    for probability in (1.0, 0.55, 0.45):
        known = probability * certain
        seen = AnswerGrounding(network, known).see(labels.images, known)
        candidates[probability] = seen.candidates(thresholds)
    assert candidates[1.0].any(1).float().mean() > 0.8
    assert torch.equal(candidates[0.55], candidates[1.0])
    assert not candidates[0.45].any()
