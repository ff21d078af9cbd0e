"""Families: instances that differ in shape, facts that follow from their parts, and the task."""

import re
import sys
from collections import Counter
from dataclasses import replace
from itertools import combinations, product
from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch

from knowarm.errors import UserError
from knowarm.experiment.names import experiment_config
from knowarm.knowledge.formats import shipped_graph
from knowarm.knowledge.queries.splits import SEEDS
from knowarm.perception.encoder import PlaceEncoder
from knowarm.perception.looks import attribute_codes, code_matrix, look_of
from knowarm.questions import kind_of
from knowarm.world.agents.play import play
from knowarm.world.agents.scripted import OracleAgent
from knowarm.world.config import EnvConfig, questions_of, scene_of
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.objects import find_targets
from knowarm.world.scene.mjcf import read_mjcf
from knowarm.world.tasks.asked.family.families import (
    FAMILIES,
    FAMILY_COLOURS,
    INSTANCES,
    KINDS,
    facts,
    instance,
)
from knowarm.world.tasks.asked.family.family import AskInstance

SPLITS = ("train", "S2", "S3a", "S3b", "S4", "S5")


def model_of(name: str) -> mujoco.MjModel:
    target = instance(name)
    return read_mjcf(target.mjcf, name, target.xml).compile()


def geoms_of(model: mujoco.MjModel) -> set[str]:
    return {re.sub(r"_\d$", "", model.geom(g).name) for g in range(model.ngeom)}


@pytest.mark.parametrize("kind", KINDS)
def test_instances_of_a_kind_differ_and_their_parts_are_geoms(kind):
    seen = set()
    for number in range(INSTANCES):
        name = f"{kind}-{number}"
        target, model = instance(name), model_of(name)
        shape, *parts = target.attributes
        every = {"handle", "spout", "neck", "foot", "rim", "lid"}
        assert every & geoms_of(model) == set(parts)
        kinds = mujoco.mjtGeom
        body = {"cylindrical": kinds.mjGEOM_CYLINDER, "round": kinds.mjGEOM_ELLIPSOID}
        assert model.geom("body").type[0] == body.get(shape, kinds.mjGEOM_BOX)
        seen.add(tuple(model.geom_size.ravel()))
        assert facts(name)["hasPart"] == tuple(parts)
        assert facts(name)["hasShape"] == (shape,)
    assert len(seen) == INSTANCES


def test_the_name_alone_decides_the_instance():
    first = instance("mug-3").xml
    instance.cache_clear()
    assert instance("mug-3").xml == first
    assert find_targets(["mug-3"])[0].xml == first


@pytest.mark.parametrize("name", ["mug-", "vase-x", "mug-x", "mug-1.5"])
def test_an_unknown_instance_is_refused(name):
    with pytest.raises(UserError, match="Unknown target"):
        find_targets([name])


def test_a_handle_is_grasped_where_it_is_and_other_objects_from_above():
    for name in FAMILIES:
        model = model_of(name)
        x, _, z = model.site("grasp").pos
        if "handle" in instance(name).attributes:
            outer = model.geom("handle_1")  # the vertical part of the loop
            assert x == pytest.approx(outer.pos[0] + outer.size[0], abs=1e-3)
            assert z == pytest.approx(outer.pos[2], abs=1e-3)
        else:
            data = mujoco.MjData(model)
            mujoco.mj_kinematics(model, data)
            assert x == 0
            assert z == pytest.approx(max(tops(model, data)) - 0.01, abs=3e-3)


def tops(model: mujoco.MjModel, data: mujoco.MjData) -> list[float]:
    """Return the upper end of each geom on the axis of the object [m]."""
    found = []
    for g in range(model.ngeom):
        name, size = model.geom(g).name, model.geom_size[g]
        if name == "spout" or name.startswith("handle"):
            continue
        is_sphere = model.geom_type[g] == mujoco.mjtGeom.mjGEOM_SPHERE
        is_cylinder = model.geom_type[g] == mujoco.mjtGeom.mjGEOM_CYLINDER
        half = size[0] if is_sphere else size[1] if is_cylinder else size[2]
        found.append(float(data.geom_xpos[g, 2] + half))
    return found


def test_the_shipped_graph_states_what_the_templates_state():
    graph = shipped_graph("families")
    stated = {
        triple for triple in graph if kind_of(triple[0].rpartition(":")[2]) in KINDS
    }
    short = {tuple(each.rpartition(":")[2] for each in triple) for triple in stated}
    wanted = {
        (name, relation, value)
        for name in FAMILIES
        for relation, values in facts(name).items()
        for value in values
    }
    assert short == wanted


def test_the_script_writes_the_shipped_graph(monkeypatch):
    scripts = Path(__file__).parents[4] / "scripts"
    monkeypatch.syspath_prepend(str(scripts))
    monkeypatch.delitem(sys.modules, "draw_families", raising=False)
    import draw_families

    assert draw_families.graph() == draw_families.GRAPH.read_text(encoding="utf-8")


def test_codes_tell_looks_apart_and_share_attributes():
    names = ["mug-0", "jug-0", "mug-0"]
    code = code_matrix(attribute_codes(names))
    assert (code[0] == code[2]).all()
    assert (code[0] != code[1]).any()
    assert attribute_codes([*names, "mug"]) is None
    looks = [look_of(name) for name in FAMILIES]
    given = attribute_codes(FAMILIES)
    codes = code_matrix(given)
    (attributes,) = {code.attributes for code in given}
    (exclusive,) = {code.exclusive for code in given}
    assert len(np.unique(codes, axis=0)) == len(set(looks))
    assert look_of("wine_glass") == ("wine_glass",)
    kinds = codes[:, attributes + 1 :]
    assert (kinds.sum(axis=1) == 1).all()
    assert kinds.shape == (len(FAMILIES), len(KINDS))
    assert set(np.unique(codes[:, :attributes])) == {-1.0, 1.0}
    assert ((codes[:, :exclusive] == 1).sum(axis=1) == 1).all()


@pytest.fixture
def recognized():
    """An encoder whose head has learned nothing, and features of 2 images with 12 x 10 places."""
    names = ("jug-18", "vase-11", "mug-0", "candle-1")
    facets = tuple((name, colour) for name in names for colour in ("red", "blue"))
    encoder = PlaceEncoder(facets, channels=64, seed=0)
    features = torch.rand(
        2, encoder.channels, 10, 12, generator=torch.Generator().manual_seed(0)
    )
    return encoder, features


def test_names_have_probabilities_by_attributes_alone(recognized):
    encoder, features = recognized
    objects, colours = encoder.logits(features)
    one = torch.ones(2)
    torch.testing.assert_close(objects.exp().sum((1, 2)), one)  # of name and place
    torch.testing.assert_close(colours.exp().sum(1), one[:, None].expand(2, 120))
    assert look_of("jug-18")[1:] == look_of("vase-11")[1:]
    # One of them may be of a new kind
    torch.testing.assert_close(objects[:, 0], objects[:, 1])
    assert not torch.allclose(objects[:, 0], objects[:, 2])


def test_training_raises_what_is_true_of_an_object_at_its_place(recognized):
    encoder, features = recognized
    facets, places = torch.tensor([[0, 5], [6, 3]]), torch.tensor([[17, 80], [3, 55]])
    optimizer = torch.optim.Adam(encoder.parameters(), 0.05)
    for _ in range(300):
        likelihood = encoder.facet_likelihood(features, facets, places)
        assert (likelihood < 0).all()
        optimizer.zero_grad()
        (-likelihood.mean()).backward()
        optimizer.step()
    objects, colours = encoder.logits(features)
    by_place = objects[:, encoder.facet_parts[0]] + colours[:, encoder.facet_parts[1]]
    for image, (seen, where) in enumerate(zip(facets, places, strict=True)):
        for facet, place in zip(seen, where, strict=True):
            best = by_place[image, :, place].topk(1 + int(facet < 4)).indices
            assert facet in best  # jug-18 and vase-11 look the same
        assert set(by_place[image].logsumexp(0).topk(2).indices.tolist()) == set(
            where.tolist()
        )


@pytest.fixture(scope="module")
def tables():
    config = experiment_config("irb120-families-answers-distil")
    splits = {"train": config.env}
    for split in SPLITS[1:]:
        splits[split] = replace(config.env, task=config.env.task.asking(split=split))
    return {split: questions_of(env) for split, env in splits.items()}


@pytest.fixture(scope="module")
def draws():
    facets = tuple(product(FAMILIES, FAMILY_COLOURS))
    queries = AskInstance().queries
    return [
        replace(queries, seed=seed).splits(facets, 4).held_out
        for seed in SEEDS.values()
    ]


def test_declared_draws_hold_out_other_kinds_and_instances(draws):
    for one, other in combinations(draws, 2):
        assert not one.new["S3a"] & other.new["S3a"]
        kinds = [set(map(kind_of, draw.new["S3b"])) for draw in (one, other)]
        assert [len(each) for each in kinds] == [4, 4]
        assert not kinds[0] & kinds[1]
        assert not one.values & other.values
        assert not one.swapped & other.swapped
        pairs = [{(c, kind_of(n)) for c, n in draw.pairs} for draw in (one, other)]
        assert not pairs[0] & pairs[1]


def shown(table) -> set[str]:
    return {table.facets[f][0] for f in np.flatnonzero(table.shown)}


def test_s3a_shows_new_instances_of_known_kinds_and_s3b_new_kinds(tables):
    train, a, b = (shown(tables[name]) for name in ("train", "S3a", "S3b"))
    kinds = {
        name: set(map(kind_of, each))
        for name, each in zip("tab", (train, a, b), strict=True)
    }
    assert not train & a
    assert not train & b
    assert not a & b
    assert kinds["a"] <= kinds["t"]
    assert not kinds["b"] & kinds["t"]
    assert kinds["b"] | kinds["t"] == set(KINDS)
    assert Counter(map(kind_of, b)) == dict.fromkeys(kinds["b"], INSTANCES)
    for name in ("S2", "S4", "S5"):
        assert shown(tables[name]) <= train


def test_s2_holds_out_a_condition_of_all_instances_of_a_kind(tables):
    train, new = tables["train"], tables["S2"]
    single = [
        row for row, query in enumerate(train.queries) if len(query.conditions) == 1
    ]
    for row in single:
        asked, held = (
            {kind_of(table.facets[f][0]) for f in np.flatnonzero(table.askable[row])}
            for table in (train, new)
        )
        assert not asked & held


@pytest.mark.parametrize("split", ["S3a", "S3b"])
def test_the_oracle_reaches_new_objects(split):
    env = EnvConfig(task=AskInstance(), image_size=8, dynamics="kinematic")
    env = replace(env, task=env.task.asking(split=split))
    world = ArmVectorEnv(env, 32)
    result = play(OracleAgent(world), world, evaluation_episodes(env, 32, 0))
    assert result.success.mean() > 0.9
    assert {
        kind_of(scene_of(env).targets[k].name) for k in result.infos["target"]
    } <= set(KINDS)
