"""Grounding network: what it is trained on, what it selects, its file, and runs that have one."""

import dataclasses

import numpy as np
import pytest
import torch

from knowarm.errors import UserError
from knowarm.experiment.agents import AGENTS, controls_of
from knowarm.experiment.build import build, load_agent, slots_of
from knowarm.experiment.grounding import (
    STRIDE,
    Grounding,
    GroundingConfig,
    centres,
    place_of,
    place_table,
)
from knowarm.experiment.grounding_training import _Task, draw_starts, train_grounding
from knowarm.experiment.perceived import FILE, PerceivingVectorEnv, module_of
from knowarm.experiment.perception import PerceptionConfig, Seen
from knowarm.experiment.registry import experiment_config
from knowarm.experiment.run import train
from knowarm.reading import UnreadableFileError
from knowarm.world.choice_source import choice_table

TINY = {"images": 64, "epochs": 2, "batch": 32}
SMALL = {"dynamics": "kinematic", "choice": {"queries": {"pairs": "none"}}}
SETTINGS = {
    "grounding": TINY,
    "total_steps": 400,
    "env": SMALL,
    "algorithm": {"num_envs": 8, "rollout_steps": 25, "minibatches": 2, "processes": 1},
    "interim": {"every_steps": 400, "episodes": 4},
}
NAME = "irb120-choose-subgraph-fast"


@pytest.fixture(scope="module")
def config():
    return experiment_config(NAME, **SETTINGS)


@pytest.fixture(scope="module")
def network(config):
    parts = build(config)
    return Grounding(
        Seen.of(config.env, PerceptionConfig()), parts.table, slots_of(parts.embedding)
    )


@pytest.fixture(scope="module")
def starts(config, network):
    return draw_starts(config.env, network.seen, 96, seed=3)


def test_places_cover_the_image_row_by_row():
    points = centres(64)
    assert points[1].tolist() == [12.0, 4.0]
    assert place_of(points, 64).tolist() == list(range(64))
    assert place_of(torch.tensor([[-3.0, 70.0]]), 64).tolist() == [56]
    table = place_table(64)
    np.testing.assert_allclose(table.mean(0), 0, atol=1e-6)
    np.testing.assert_allclose(table.std(0), 1, atol=1e-6)
    assert len(place_table(90)) == 12**2


def test_the_labels_are_where_the_objects_are_seen():
    """In the marked image the wanted object is the only magenta one."""
    config = experiment_config("irb120-choose-mask-fast", env=SMALL)
    seen = Seen.of(config.env, PerceptionConfig())
    found = draw_starts(config.env, seen, 64, seed=0)
    image = found.images.float()
    magenta = (image[..., 0] - image[..., 1]).clamp(min=0) * (image[..., 2] - image[..., 1] > 40)
    line = torch.arange(64) + 0.5
    total = magenta.sum((1, 2)).clamp(min=1)
    column = (magenta * line).sum((1, 2)) / total
    row = (magenta * line[:, None]).sum((1, 2)) / total
    away = (found.pixels[:, 0] - torch.stack((column, row), 1)).norm(dim=1)
    assert away.median() < STRIDE / 2
    others = (found.pixels[:, 1:] - torch.stack((column, row), 1)[:, None]).norm(dim=2)
    assert (away < others.min(1).values).float().mean() > 0.95


def test_the_losses_are_those_of_a_plain_loop(config, network, starts):
    task = _Task(config.env, network, starts)
    task._low = False
    rows, queries = torch.arange(0, 96, 7), torch.arange(0, 49, 3)
    table, facets = choice_table(config.env), network.seen.facets
    column = {facets.index(facet): number for number, facet in enumerate(table.facets)}
    errors, named = [], []
    with torch.no_grad():
        place, naming = task.losses(rows, queries)
        for row in rows.tolist():
            features = network.features(starts.images[row][None])
            shown = [column[facet] for facet in starts.facets[row].tolist()]
            for query in queries.tolist():
                answers = [i for i, f in enumerate(shown) if table.satisfies[query, f]]
                if len(answers) != 1 or not table.askable[query, shown[answers[0]]]:
                    continue
                wanted = network.wanted(network.knowledge[query][None])[0]
                scores = (network.keys(features)[0] @ wanted).log_softmax(0)
                errors.append(-scores[place_of(starts.pixels[row, answers[0]], 64)])
            names = network.names(features)[0].log_softmax(0)
            named.append(-names[starts.facets[row]].mean())
    assert len(errors) > 20
    torch.testing.assert_close(place, torch.stack(errors).mean(), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(naming, torch.stack(named).mean(), rtol=1e-4, atol=1e-4)


def test_names_are_sums_over_places(network, starts):
    """The product of matrices equals the logarithm of the sum of exponentials, also if small."""
    with torch.no_grad():
        features = 20 * network.features(starts.images[:4])
        objects, colours = (
            head(features).flatten(2) for head in (network.objects, network.colours)
        )
        objects, colours = objects[:, network._object], colours[:, network._colour]
        expected = torch.logsumexp(objects + colours, dim=2)
        found = network.names(features)
    likely = expected > expected.max(1, keepdim=True).values - 60
    torch.testing.assert_close(found[likely], expected[likely], rtol=1e-4, atol=1e-3)
    assert found.isfinite().all()


def test_training_lowers_the_loss_of_places_and_repeats_to_the_byte(config):
    parts = build(config)
    lines = []
    arguments = (config.env, parts.table, slots_of(parts.embedding))
    settings = GroundingConfig(images=512, epochs=6, batch=32)
    network = train_grounding(*arguments, settings, seed=1, report=lines.append)
    losses = [float(line.rsplit(" ", 1)[1]) for line in lines[1:]]
    assert losses[-1] < 0.85 * losses[0]
    again = train_grounding(*arguments, settings, seed=1)
    assert network.to_bytes() == again.to_bytes()
    other = train_grounding(*arguments, dataclasses.replace(settings, epochs=1), seed=2)
    assert other.to_bytes() != network.to_bytes()
    assert train_grounding(*arguments, settings, seed=1, should_stop=lambda: True) is None


def test_a_slot_of_zeros_is_no_condition(network):
    one = torch.zeros(1, network.knowledge.shape[1])
    assert (network.wanted(one) == 0).all()


def test_the_policy_is_told_the_place_found_in_the_first_image(config, network):
    env = PerceivingVectorEnv(config.env, 6, network, num_threads=1)
    images, infos = env.reset(seed=0)
    first = network.places(images, torch.as_tensor(infos["query"]))
    assert torch.equal(env.facet_ids, first)
    for _ in range(3):
        env.step(torch.zeros(6, env.scene.num_joints, dtype=torch.int64))
    assert torch.equal(env.facet_ids, first)
    parts = build(config)
    assert parts.table.shape[0] == 49
    told = parts.new_policy(0).knowledge_table
    np.testing.assert_array_equal(told.numpy(), place_table(64))


def test_the_file_holds_the_network_and_its_table(network, starts):
    again = module_of(network.to_bytes())
    assert isinstance(again, Grounding)
    assert torch.equal(again.knowledge, network.knowledge)
    queries = starts.queries[:8]
    assert torch.equal(
        again.places(starts.images[:8], queries), network.places(starts.images[:8], queries)
    )
    for damaged in (network.to_bytes()[:-40], b"no file"):
        with pytest.raises(UnreadableFileError, match=FILE):
            module_of(damaged)


def test_a_run_keeps_its_network_and_resumes_to_the_byte(tmp_path, config):
    whole = train(config, tmp_path / "whole")
    kept = (whole.folder.path / FILE).read_bytes()
    # Stopped while the network is trained, then between two updates.
    asked = []
    stopped = train(config, tmp_path / "cut", should_stop=lambda: asked.append(0) or len(asked) > 1)
    assert (stopped.result.reason, stopped.result.step) == ("stopped", 0)
    rows = tmp_path / "cut" / NAME / "0" / "metrics.csv"
    stopped = train(config, tmp_path / "cut", resume=True, should_stop=rows.exists)
    assert stopped.result.reason == "stopped"
    resumed = train(config, tmp_path / "cut", resume=True)
    assert (resumed.folder.path / FILE).read_bytes() == kept
    for part in ("policy", "optimizer", "state"):
        name = f"checkpoints/latest/{part}.safetensors"
        one, two = (run.folder.path / name for run in (whole, resumed))
        assert one.read_bytes() == two.read_bytes()
    agent = load_agent(resumed.folder.path).agent
    assert isinstance(agent.perception, Grounding)
    assert resumed.folder.provenance()["perception"]["config"]["images"] == TINY["images"]


def test_agents_that_are_told_a_query_are_grounded_alike():
    told = [name for name, agent in AGENTS.items() if agent.grounding is not None]
    assert {"subgraph", "query-words", "query-onehot", "subgraph-shuffled"} <= {*told}
    assert all(AGENTS[name].knowledge.scope == "query" for name in told)
    assert "query-onehot" in controls_of("subgraph", "content_control")
    assert controls_of("subgraph-similarity", "content_control") == []


@pytest.mark.parametrize("name", ["irb120-full-fast", "irb120-choose-bm-fast"])
def test_only_queries_are_grounded(name):
    with pytest.raises(UserError, match="grounding finds what a query means"):
        experiment_config(name, grounding=GroundingConfig())


@pytest.mark.parametrize(
    ("field", "value"),
    [("images", 0), ("epochs", 0), ("batch", 0), ("learning_rate", 0.0), ("naming_coef", -1.0)],
)
def test_numbers_out_of_range_are_refused(field, value):
    with pytest.raises(UserError, match=field):
        GroundingConfig(**{field: value})
