"""Reasoning by vectors or by the graph: agents, evaluations, controls and damaged graphs."""

import dataclasses
from functools import partial

import numpy as np
import pytest
import torch

from knowarm.errors import UserError
from knowarm.experiment.agents import AGENTS
from knowarm.experiment.evaluate import evaluate, known_in_test
from knowarm.experiment.evaluation import (
    DamageTest,
    GraphTest,
    ReasoningTest,
    SplitTest,
    Subject,
)
from knowarm.experiment.knows import reason_by
from knowarm.experiment.load import load_agent
from knowarm.experiment.names import experiment_config, tasks_of
from knowarm.experiment.other_graphs import with_graph
from knowarm.experiment.run import build, train
from knowarm.knowledge.graph.builder import graph_of
from knowarm.perception.config import GroundingSpec
from knowarm.perception.grounding import GroundingNetwork
from knowarm.perception.recognition import AnsweringAgent
from knowarm.world.config import facets_of, questions_of
from knowarm.world.tasks.asked.query.query import CHOOSE_TARGETS
from tests.experiment.test_zoo import ZOO
from tests.thorough import thorough
from tests.tiny import CHOOSE, CHOOSE_ENV

ASKED = [
    name
    for name, agent in AGENTS.items()
    if agent.knows.scope == "query" and "choose" in tasks_of(agent)
]
BRIEF = {"episodes": thorough(40, 60), "probes": (), "write": False}


def test_an_agent_trains_with_the_answers_of_its_graph_and_plays_from_its_folder(
    tmp_path,
):
    run = train("irb120-choose-answers-fast", tmp_path, **CHOOSE)
    trained = load_agent(run.folder.path)
    assert isinstance(trained.agent, AnsweringAgent)
    config = trained.config
    satisfies = questions_of(config.env).satisfies
    assert (trained.agent.recognition.knowledge.numpy() == satisfies).all()
    result = evaluate(trained, **{**BRIEF, "episodes": 8})
    assert set(result.episodes["visible_answers"]) <= {0, 1, 2, 3, 4}
    subject = Subject(env=config.env, config=config)
    assert known_in_test(trained, subject) is trained.agent
    others = SplitTest(split="S1").prepare(subject)
    assert known_in_test(trained, others) is not trained.agent
    by_vector = evaluate(
        trained, test=(ReasoningTest(by="vector"),), **{**BRIEF, "episodes": 8}
    )
    assert "visible_answers" not in by_vector.episodes
    shuffled = experiment_config("irb120-choose-answers-shuffled-fast", env=CHOOSE_ENV)
    answers = shuffled.knows.answers(shuffled.env, 0, facets_of(shuffled.env))
    assert (answers != satisfies).any()


@pytest.mark.slow(40)
def test_the_graph_answers_new_pairs_and_an_edited_graph_and_its_controls_do_not(
    trained,
):
    def right(split, reasoning):
        test = (SplitTest(split=split), ReasoningTest(by=reasoning))
        return evaluate(trained, test=test, **BRIEF).summary["choice"]

    assert right("S5", "graph") > 0.9
    graph, shuffled, colours = (
        right("S2", each) for each in ("graph", "graph-shuffled", "colours")
    )
    assert graph > 0.9
    assert shuffled < graph - 0.2
    assert colours < graph - 0.1


@pytest.mark.slow(40)
def test_damage_lowers_right_choices_of_vectors_and_answers(trained):
    def right(reasoning, **damage):
        test = [SplitTest(split="S1"), ReasoningTest(by=reasoning)]
        test += [DamageTest(**damage)] if damage else []
        return evaluate(trained, test=tuple(test), **BRIEF).summary["choice"]

    before = trained.network.knowledge.clone()
    adversarial = {"damage": "adversarial", "share": 0.6}
    assert right("graph") > 0.9
    assert right("graph", **adversarial) < 0.7
    assert right("vector") - right("vector", **adversarial) > 0.02
    assert (trained.network.knowledge == before).all()


def test_another_graph_asks_and_answers(trained, tmp_path):
    """Relations that the software has never seen, about five of the objects; one is unknown."""
    names = ["mug", "vase", "kettle", "book", "lamp"]
    rows = [
        f"{name}\tgoesWith\t{value}" for name, value in zip(names, "aabbc", strict=True)
    ]
    rows += [
        f"{name}\tweighs\t{value}" for name, value in zip(names, "xyxyx", strict=True)
    ]
    graph = tmp_path / "other.tsv"
    graph.write_text("\n".join([*rows, "sofa\tgoesWith\ta"]))
    test = (GraphTest(graph=str(graph)), ReasoningTest(by="graph"))
    result = evaluate(trained, test=test, **BRIEF)
    assert set(result.episodes["chosen"]) <= set(names)
    assert {query.split(" ")[0] for query in result.episodes["query"]} == {
        "goesWith",
        "weighs",
        "hasColor",
    }
    assert result.summary["choice"] > 0.85
    assert result.summary.label == "post-training-greedy-other-graph"
    graph.write_text(graph.read_text().replace("mug\t", "CoffeeCup\t"))
    named = dataclasses.replace(test[0], names={"mug": "CoffeeCup"})
    again = evaluate(trained, test=(named, test[1]), **BRIEF)
    assert again.summary.numbers == result.summary.numbers
    # The given graph, not a copy with names
    assert again.summary.env == result.summary.env
    assert again.summary.config.test[0] == named
    with pytest.raises(UserError, match="has an entity 'vase' of its own"):
        evaluate(
            trained,
            test=(dataclasses.replace(named, names={"vase": "CoffeeCup"}),),
            **BRIEF,
        )
    graph.write_text(graph.read_text().replace("CoffeeCup\t", "mug\t"))
    missing = evaluate(
        trained, test=(*test, DamageTest(damage="missing", share=1.0)), **BRIEF
    )
    assert missing.summary["choice"] < result.summary["choice"] - 0.1
    with pytest.raises(
        UserError, match="everything that it can be asked is a question of S1"
    ):
        evaluate(trained, test=(SplitTest(split="S4"), *test), **BRIEF)
    graph.write_text("\n".join(rows[:3]))
    with pytest.raises(UserError, match="describes 3 objects of the task"):
        evaluate(trained, test=test, **BRIEF)
    with pytest.raises(UserError, match="has no queries that a graph could answer"):
        evaluate(ZOO / "irb120-full-fast", test=test, **BRIEF)


def test_a_repaired_graph_answers_otherwise(trained):
    env = trained.config.env
    how = DamageTest(damage="missing", share=0.6, repair="complex")
    subject = Subject(env=env, config=trained.config)
    graphs = [
        each.prepare(subject).graph
        for each in (how, dataclasses.replace(how, repair=None))
    ]
    assert set(graphs[0]) > set(graphs[1])
    none = experiment_config("irb120-choose-bm-fast")
    with pytest.raises(UserError, match="changes a graph, and agent 'bm' has none"):
        how.prepare(dataclasses.replace(subject, config=none))


def test_reasoning_needs_a_network_and_damage_a_graph(choose_run):
    reach = ZOO / "irb120-full-fast"
    with pytest.raises(UserError, match="has no grounding network"):
        evaluate(reach, test=(ReasoningTest(by="graph"),), **BRIEF)
    with pytest.raises(UserError, match=r"Unknown value of test\[0\]\.by"):
        evaluate(choose_run, test=[{"kind": "reasoning", "by": "guessing"}], **BRIEF)
    with pytest.raises(UserError, match=r"damage\.share must be between 0 and 1"):
        DamageTest(damage="missing", share=1.5)


@pytest.mark.parametrize("name", ASKED)
def test_the_query_enters_through_its_vector_only(name):
    """Without training: swapped rows swap what the agent does, and zeros make all queries one.

    The rows are vectors, or the answers of the graph for an agent that answers by it.
    """
    config = experiment_config(f"irb120-choose-{name}-fast", env=CHOOSE_ENV)
    parts = build(config)
    table = torch.from_numpy(parts.knowledge.table)
    generator = torch.Generator().manual_seed(0)
    image = torch.randint(
        0, 256, (1, 64, 64, 3), dtype=torch.uint8, generator=generator
    )
    images = image.expand(len(table), -1, -1, -1)
    if config.knows.grounding is not None:
        spec = GroundingSpec.of(config.env, config.knows.grounding)
        slots = parts.knowledge.embedding.slots_per_row
        network = GroundingNetwork(spec, table, slots)
        recognition = config.knows.known(config.env, 0, network=network).recognition
        table = recognition.knowledge
        act = partial(recognition.locate, images)
    else:
        policy = parts.new_policy(0)
        start = torch.ones(len(table), dtype=torch.bool)
        state = policy.initial_state(len(table))

        def act(known):
            return policy.step(images, known, state, start)[0]

    with torch.no_grad():
        real, zeroed = act(table), act(torch.zeros_like(table))
        torch.testing.assert_close(
            act(table.flip(0)).flip(0), real, rtol=1e-4, atol=1e-5
        )
    torch.testing.assert_close(
        zeroed, zeroed[:1].expand_as(zeroed), rtol=1e-4, atol=1e-5
    )
    if AGENTS[name].role == "knowledge":
        assert np.ptp(real.numpy(), axis=0).max() > 1e-4


def test_an_empty_graph_is_not_the_intact_one(trained):
    env, facets = trained.config.env, trained.network.spec.facets
    knows = reason_by(trained.config.knows, "graph", "subgraph")
    assert knows.answers(env, 0, facets).any()
    with pytest.raises(UserError, match="no facets to ask about"):
        knows.answers(env, 0, facets, graph=graph_of([]))


def test_targets_of_files_go_by_their_names():
    bowl = str(ZOO.parent / "examples" / "own_robot" / "bowl.toml")
    targets = [*(name for name in CHOOSE_TARGETS if name != "bowl"), bowl]
    config = experiment_config("irb120-choose-answers-fast", env={"targets": targets})
    assert bowl in with_graph(config, "objects").env.targets
    how = DamageTest(damage="missing", share=1.0)
    graph = how.prepare(Subject(env=config.env, config=config)).graph
    assert not len(graph.out_rows(graph.entity_id("bowl")))
