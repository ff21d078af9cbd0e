"""Tidying: the graph and the network plan, the arm brings one object after another."""

import json
from contextlib import closing
from itertools import islice
from pathlib import Path
from threading import Thread
from urllib.request import urlopen

import numpy as np
import pytest

import knowarm
from knowarm.asking.asker import Asker
from knowarm.asking.page import make_server
from knowarm.asking.tidying.tidier import Tidying, join_scenes, scenes_to_tidy
from knowarm.cli.main import main
from knowarm.knowledge.formats import read_graph
from knowarm.knowledge.graph.edits import edited
from knowarm.world.config import facets_of
from knowarm.world.tasks.skills.sort.belongings import true_belongings
from knowarm.world.tasks.skills.sort.sort import apart
from tests.thorough import thorough

pytestmark = pytest.mark.usefixtures("small_films")

ZOO = Path(__file__).parents[2] / "zoo"
RUN = ZOO / "tiago-choose-sort-answers-seen"
SCENES = thorough(2, 3)


@pytest.fixture(scope="module")
def trained():
    return knowarm.load_agent(RUN)


@pytest.fixture(scope="module")
def scenes(trained):
    return join_scenes(list(islice(scenes_to_tidy(trained.config.env), SCENES)))


@pytest.fixture
def tidying(trained, scenes):
    with closing(Tidying(trained, scenes, read_graph("objects"))) as made:
        yield made


def test_scenes_have_one_object_for_each_tray(trained, scenes, tidying):
    env = trained.config.env
    known = true_belongings(env.task.asked, facets_of(env), env.task.skill.relation)
    for objects, places in zip(scenes.objects, tidying.told["places"], strict=True):
        belongs = known.of(objects[None], places[None])[0]
        assert belongs.sum(axis=0).tolist() == [1, 1]
        assert belongs.sum(axis=1).max() == 1


def test_the_plan_follows_from_image_graph_and_what_is_told(tidying):
    planned = {}
    for errand in tidying.plan(0):
        planned[errand.facet] = (errand.tray, errand.place, errand.facts)
    assert tidying.instruction(0) == (
        "the yellow tray is the classroom; the green tray is the garden"
    )
    assert planned == {
        ("basket", "cyan"): ("green", "garden", ("basket isLocatedIn garden",)),
        ("bell", "green"): ("yellow", "classroom", ("bell isLocatedIn classroom",)),
        ("pitcher", "purple"): ("", "", ()),
        ("mallet", "red"): ("", "", ()),
    }


def test_objects_are_brought_one_after_the_other(tidying):
    graph = read_graph("objects")
    before = tidying.judge(graph)
    assert not before.in_place.any()
    assert not before.moved.any()
    home = tidying.env.joint_positions.copy()
    first = tidying.step()
    assert (first >= 0).all()
    assert 1 <= tidying.judge(graph).in_place.sum() <= SCENES
    assert np.abs(tidying.env.joint_positions - home).max() < 0.05
    steps = 1
    while (tidying.step() >= 0).any():
        steps += 1
    assert 2 <= steps <= 4
    end = tidying.judge(graph)
    assert end.in_place.sum() >= 2 * SCENES - 1
    assert end.is_tidy.sum() >= SCENES - 1
    assert not end.wrong_place.any()
    assert not end.disturbed.all()


def test_where_physics_became_unstable_nothing_stands_and_nothing_counts_as_moved(
    tidying,
):
    env = tidying.env
    simulation = env.simulation
    simulation.batch.bind("qvel")[0, simulation._target_qvel] = 1e12
    nothing = np.zeros(env.action_space.shape, np.int64)
    env.advance(nothing, np.zeros(SCENES, bool))
    assert simulation.unstable.tolist() == [True, *[False] * (SCENES - 1)]
    end = tidying.judge(read_graph("objects"))
    assert not end.moved.any()
    assert (end.stands == -1).all()
    assert not end.is_tidy.any()


def test_an_edit_between_two_objects_changes_the_rest_of_the_plan(tidying):
    graph = read_graph("objects")
    tidying.step()
    done = {"basket", "bell"} - {errand.facet[0] for errand in tidying.plan(0)}
    assert done == {"basket"}
    changes = [
        "- bell isLocatedIn classroom",
        "- mallet isLocatedIn garage",
        "+ mallet isLocatedIn classroom",
    ]
    tidying.graph = edited(graph, changes)
    trays = {errand.facet[0]: errand.tray for errand in tidying.plan(0)}
    assert trays == {"bell": "", "pitcher": "", "mallet": "yellow"}
    tidying.step()
    by_name = {errand.facet[0] for errand in tidying.plan(0)}
    assert by_name == {"bell", "pitcher"}
    names = [
        tidying.env.scene.targets[number].name
        for number in tidying.env.running.objects[0]
    ]
    end = tidying.judge(tidying.graph)
    in_place = {
        name for name, is_so in zip(names, end.in_place[0], strict=True) if is_so
    }
    assert in_place == {"basket", "mallet"}


def test_a_tray_takes_one_object(tidying):
    changes = ["- bell isLocatedIn classroom", "+ bell isLocatedIn garden"]
    tidying.graph = edited(read_graph("objects"), changes)
    reasons = {errand.facet[0]: errand.why for errand in tidying.plan(0)}
    assert reasons["basket"] == ""
    assert reasons["bell"] == "the green tray, where it belongs, takes one object"


def test_without_a_graph_everything_stays(trained, scenes):
    with closing(Tidying(trained, scenes[:1], None)) as tidying:
        assert all(errand.tray == "" for errand in tidying.plan(0))
        assert tidying.step().tolist() == [-1]


def test_what_is_still_there_is_tried_once_more_then_left(trained, scenes):
    with closing(Tidying(trained, scenes[:1], read_graph("objects"))) as tidying:
        state = tidying.env.running
        basket = np.flatnonzero(
            [
                state.scene.targets[number].name == "basket"
                for number in state.objects[0]
            ]
        )
        target = state.objects[:, basket[0]]
        origin, turn = (array.copy() for array in state.simulator.pose(target))

        def put_back():
            state.simulator.set_pose(np.arange(1), target, origin, turn)

        first = tidying.step(put_back)
        assert tidying.facet(0, first[0])[0] == "basket"
        assert tidying.is_left(0, first[0])
        assert "basket" in {errand.facet[0] for errand in tidying.plan(0)}
        assert tidying.step(put_back) == first
        assert "basket" not in {errand.facet[0] for errand in tidying.plan(0)}
        assert tidying.facet(0, tidying.step()[0])[0] == "bell"


def test_places_on_neighbouring_trays_are_apart():
    spots = apart(np.array([[0.6, 0.0], [0.74, 0.0], [0.0, 1.0]]))
    assert np.linalg.norm(spots[0] - spots[1]) == pytest.approx(0.19)


def test_command_tells_plan_and_end(tmp_path, capsys):
    page = tmp_path / "tidy.html"
    values = tmp_path / "tidy.json"
    change = "1: - bell isLocatedIn classroom"
    late = "9: - mug isLocatedIn kitchen"
    code = main(
        [
            "tidy",
            str(RUN),
            "--after",
            change,
            late,
            "--page",
            str(page),
            "--json",
            str(values),
        ]
    )
    assert code == 0
    printed = capsys.readouterr().out
    plan = printed.index(
        "Plan: the cyan basket to the green tray, the garden: basket isLocatedIn garden."
    )
    assert plan < printed.index("The arm looks again: the cyan basket is gone")
    assert "The graph changes: - bell isLocatedIn classroom." in printed
    assert "Not changed: fewer than 9 objects were brought away" in printed
    assert "The cyan basket stands on the tray of its place." in printed
    assert "The green bell stays where it was." in printed
    assert page.read_text(encoding="utf-8").count("<img ") == 2
    told = json.loads(values.read_text(encoding="utf-8"))
    assert told["tidy"] is True
    assert len(told["plans"]) == 2


def test_command_counts_with_a_control(capsys):
    assert main(["tidy", str(RUN), "--scenes", "2", "--places", "unknown"]) == 0
    printed = capsys.readouterr().out
    assert "tidy scenes" in printed
    assert "0.0 [0, 66]" in printed


def test_a_blind_agent_sees_the_same_in_all_scenes(trained, scenes):
    named = {}
    for blind in (True, False):
        made = Tidying(trained, scenes, read_graph("objects"), blind=blind)
        with closing(made) as tidying:
            named[blind] = {tidying.facet(scene, 0) for scene in range(SCENES)}
    assert len(named[True]) == 1
    assert len(named[False]) > 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["zoo/irb120-choose-answers-fast"], "needs an agent that sorts"),
        ([str(RUN), "--after", "bell"], "number of objects that were brought away"),
        ([str(RUN), "--scene", "-1"], "scene must be"),
        ([str(RUN), "--scene", "9999"], "Only"),
        ([str(RUN), "--page", "tidy.txt"], ".html"),
        ([str(RUN), "--edit", "bell"], "bell"),
        ([str(RUN), "--after", "2: - cow isLocatedIn garden"], "cow"),
        ([str(RUN), "--places", "shuffled"], "--scenes"),
        ([str(RUN), "--blind"], "--scenes"),
        ([str(RUN), "--scenes", "2", "--after", "1: - a b c"], "leave out"),
    ],
)
def test_mistakes_are_one_line(arguments, words, capsys):
    assert main(["tidy", *arguments]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert "Traceback" not in error
    assert len(error.strip().splitlines()) <= 2


def test_page_has_a_view_that_tidies(trained):
    with closing(Asker(trained)) as asker:
        server = make_server(asker, "")
        thread = Thread(target=server.serve_forever, daemon=True)
        thread.start()
        address = f"http://127.0.0.1:{server.server_port}"

        def get(path):
            with urlopen(address + path) as answer:
                return answer.read().decode()

        try:
            assert 'href="/tidy"' in get("/")
            empty = get("/tidy")
            assert 'name="after"' in empty
            assert "Plan:" not in empty
            assert "is a number from 0 on" in get("/tidy?scene=x")
            done = get("/tidy?scene=0&after=1:%20-%20bell%20isLocatedIn%20classroom")
            assert "The cyan basket stands on the tray of its place." in done
            assert "The graph changes: - bell isLocatedIn classroom." in done
            assert done.count("data:image/webp") == 2
        finally:
            server.shutdown()
            server.server_close()
