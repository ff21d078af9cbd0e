"""`knowarm ask`: answers, scene, arm, edits, other people's graphs, the page and its server."""

import gc
import html
import http.client
import json
import re
import socket
import threading
import time
import weakref
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from knowarm.asking.asker import Asker
from knowarm.asking.page import (
    LETTER,
    LINE,
    PADDING,
    WIDTH,
    make_server,
    page,
    place_labels,
)
from knowarm.cli.main import main
from knowarm.errors import UserError
from knowarm.experiment.load import load_agent
from knowarm.experiment.names import experiment_config
from knowarm.perception.config import GroundingSpec

pytestmark = pytest.mark.usefixtures("small_films")

ROOT = Path(__file__).parents[2]
RUN = str(ROOT / "zoo" / "irb120-choose-subgraph-fast")


@pytest.fixture(scope="module")
def asker():
    with_network = Asker(load_agent(RUN))
    yield with_network
    with_network.close()


def ask(asker, question, edits=()):
    answers = asker.answers(question, edits)
    return asker.play(answers, asker.scene([answers]))


def test_a_question_is_answered_from_the_command_line(tmp_path, capsys):
    path, web = tmp_path / "answer.json", tmp_path / "answer.html"
    question = "something to drink from that is not blue"
    assert main(["ask", RUN, question, "--json", str(path), "--page", str(web)]) == 0
    found = json.loads(path.read_text())
    answering = set(found["answers"])
    assert "mug/red" in answering
    assert "mug/blue" not in answering
    assert len(answering & set(found["shown"])) == 1
    assert found["shown"][0] in answering
    assert found["right"]
    assert found["success"]
    assert found["reached"] == found["shown"][0]
    printed = capsys.readouterr().out
    assert "mug usedFor drinking" in printed
    assert "which answers, after" in printed
    text = web.read_text()
    assert f"<h2>{question}</h2>" in text
    assert "<code>usedFor drinking and not hasColor blue</code>" in text
    assert "mug usedFor drinking" in text
    assert "data:image/webp" in text
    assert "http" not in text.replace("http-equiv", "")


def test_without_a_run_the_policy_of_the_package_answers(tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    assert main(["ask", "something to drink from", "--json", "answer.json"]) == 0
    assert json.loads(Path("answer.json").read_text())["success"]
    assert "zoo/irb120-choose-answers-fast is that of a clone: " in caplog.text
    # Questions that look like paths at first sight.
    long = "usedFor drinking or " * 20 + "usedFor drinking"
    assert main(["ask", long, "--json", "answer.json"]) == 0
    assert main(["ask", "hasColor red/blue"]) == 2
    assert "is not a run folder" not in caplog.text


def test_an_edit_may_give_a_question_its_first_answer(tmp_path):
    path = tmp_path / "first.json"
    words = ["ask", RUN, "usedFor juggling", "--edit", "+ lamp usedFor juggling"]
    assert main([*words, "--json", str(path)]) == 0
    assert {name.split("/")[0] for name in json.loads(path.read_text())["answers"]} == {
        "lamp"
    }


def test_an_edit_leads_the_arm_to_another_object(asker, tmp_path, capsys):
    path, edits = (
        tmp_path / "edited.json",
        ["- mug usedFor drinking", "+ lamp usedFor drinking"],
    )
    assert (
        main(["ask", RUN, "usedFor drinking", "--edit", *edits, "--json", str(path)])
        == 0
    )
    found = json.loads(path.read_text())
    assert found["reached"].startswith("lamp")
    assert found["right"]
    assert any(name.startswith("mug") for name in found["shown"])
    again = asker.ask("usedFor drinking", scene=found["scene"])
    assert again.reached[0] == "mug"
    assert again.right
    capsys.readouterr()


def test_a_graph_of_others_is_asked_as_it_lies(tmp_path, capsys):
    """Names in another spelling, given names, one that two things have, and a further column."""
    home, path = tmp_path / "home.dat", tmp_path / "found.json"
    rows = [
        "Source;Target;Type;Weight",
        "WineGlass;Drinking;UsedFor;2",
        "TeaCup;Drinking;UsedFor;1",
    ]
    rows += [
        "http://a.org/lamp;Drinking;UsedFor;1",
        "http://b.org/lamp;Drinking;UsedFor;1",
    ]
    home.write_text("\n".join(rows), "utf-16")
    (tmp_path / "names.txt").write_text("mug = teacup\n")
    options = [
        "--graph",
        str(home),
        "--format",
        "csv",
        "--names",
        str(tmp_path / "names.txt"),
    ]
    assert main(["ask", RUN, "usedFor drinking", *options, "--json", str(path)]) == 0
    answers = json.loads(path.read_text())["answers"]
    assert {each.split("/")[0] for each in answers} == {"wine_glass", "mug"}
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(str(home))[-1][:40] for line in lines] == [
        ": left out are values that are not read: Weight."[:40],
        "knowarm: warning: 'lamp' names 2 entitie",
    ]
    assert main(["ask", RUN, "usedFor drinking", "--graph", str(home)]) == 2
    assert "Or give the format: " in capsys.readouterr().err
    assert main(["ask", RUN, "usedFor drinking", "--names", "mug"]) == 2
    assert "Give mug=CoffeeMug, or a file of such lines" in capsys.readouterr().err


def test_a_graph_with_relations_never_seen_needs_no_training(tmp_path, capsys):
    path = tmp_path / "found.json"
    options = [
        "--graph",
        str(ROOT / "examples" / "own_graph" / "tidy.csv"),
        "--json",
        str(path),
    ]
    assert (
        main(["ask", RUN, "belongsIn desk and not ownedBy grandfather", *options]) == 0
    )
    found = json.loads(path.read_text())
    assert {each.split("/")[0] for each in found["answers"]} == {"lamp", "book"}
    assert found["right"]
    capsys.readouterr()
    for question, message in (
        ("needs paper", "Unknown value of needs 'paper'. Available: electricity"),
        ("ownedBy desk", "No object of the task answers the question 'ownedBy desk'"),
        ("ownedBy grandmother and", "expected a relation, got its end"),
        (
            time := "needs electricity and ownedBy grandfather",
            f"answers {time!r}: clock.",
        ),
    ):
        assert main(["ask", RUN, question, *options]) == 2
        error = capsys.readouterr().err
        assert message in error
        assert error.count("\n") == 1


def test_how_the_scene_was_chosen_is_said(asker, monkeypatch):
    """A scene in which the arm succeeds is an example: those that failed are counted."""
    found = asker.ask("usedFor drinking")
    assert found.selection.endswith("and the arm succeeds.")
    assert not asker.ask("usedFor drinking", scene=found.scene).selection

    played = []
    play = asker.play

    def fail_twice(*arguments, **options):
        asked = play(*arguments, **options)
        played.append(asked.scene)
        return replace(asked, within=asked.within and len(played) > 2)

    monkeypatch.setattr(asker, "play", fail_twice)
    later = asker.ask("usedFor drinking")
    assert len(set(played)) == len(played) > 2
    assert later.selection.endswith(f"it failed in {len(played) - 1} before.")

    def fail(*arguments, **options):
        return replace(play(*arguments, **options), within=False)

    monkeypatch.setattr("knowarm.asking.asker.LOOKED_AT", 4)
    monkeypatch.setattr(asker, "play", fail)
    assert "the arm succeeds in none" in asker.ask("usedFor drinking").selection


def test_without_one_visible_answer_the_arm_can_stay(asker):
    question = "isMadeOf wood or isMadeOf metal or isMadeOf glass or isMadeOf plastic"
    stays = asker.ask(question, scene=0, unclear="stop")
    assert len(stays.candidates) != 1
    assert stays.stopped
    assert "The arm stayed" in stays.outcome
    assert all((f.policy == stays.film[0].policy).all() for f in stays.film[:3])
    assert not asker.ask(question, scene=0, unclear="guess").stopped


def test_the_sentence_measures_the_object_that_was_reached(asker):
    """Not the first of several that answer."""
    question = "isMadeOf wood or isMadeOf metal or isMadeOf glass or isMadeOf plastic"
    found = [asker.ask(question, scene=scene, unclear="guess") for scene in range(12)]
    others = [
        asked for asked in found if asked.right and asked.reached != asked.shown[0]
    ]
    assert len(others) >= 2
    for asked in others:
        film_end = asked.film[-1]  # measured to the first that answers
        assert asked.distance < film_end.distance
        assert f"{100 * asked.distance:.1f} cm" in asked.outcome
        assert ("did not arrive" in asked.outcome) is not asked.within
    for mark, changes in (
        ("good", {"within": True}), ("bad", {"within": False}), ("open", {"stopped": True}),
    ):  # fmt: skip
        assert f'class="verdict {mark}"' in page(
            replace(others[0], **changes), question, []
        )
    assert any(asked.within for asked in others)


def test_the_user_picks_where_several_objects_may_be_meant(
    monkeypatch, capsys, tmp_path
):
    path = tmp_path / "found.json"
    words = ["ask", RUN, "not red", "--scene", "0"]
    words += ["--unclear", "ask", "--json", str(path)]
    monkeypatch.setattr("builtins.input", lambda prompt: "2")
    assert main(words) == 0
    found, printed = json.loads(path.read_text()), capsys.readouterr().out
    assert len(found["candidates"]) > 1
    assert "The arm stayed: it sees several answers: " in printed
    assert f"2: the {' '.join(reversed(found['candidates'][1].split('/')))}" in printed
    assert found["reached"] == found["candidates"][1]
    monkeypatch.setattr("builtins.input", lambda prompt: "x")
    assert main(words) == 0
    assert json.loads(path.read_text())["steps"] == 50  # it stays to the end


def test_a_policy_meets_a_graph_in_a_table(capsys, tmp_path):
    path = tmp_path / "home.csv"
    path.write_text(
        "head,relation,tail\nCoffeeCup,holds,tea\nvase,holds,rose\nsofa,holds,cat\n"
    )
    assert (
        main(
            ["ask", RUN, "holds tea", "--graph", str(path), "--names", "mug=CoffeeCup"]
        )
        == 0
    )
    printed = " ".join(capsys.readouterr().out.split())
    assert "recognized and described │ 2 │ mug, vase" in printed
    assert "recognized only │ 24 │ bottle" in printed
    assert "described only │ 1 │ sofa" in printed
    assert main(["evaluate", RUN, "--names", "mug=CoffeeCup"]) == 2
    assert "give --graph" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([RUN], f"Give a question: knowarm ask {RUN} '"),
        ([], "Give a question: knowarm ask '"),
        (["runs/none"], "Give a question: knowarm ask runs/none "),
        (["zoo/irb120"], "Give a question: knowarm ask zoo/irb120 "),
        ([RUN, "--browser", "--page", "x.html"], "leave out --page"),
        (
            [RUN, "--browser", "--port", "70000"],
            "Cannot listen on 127.0.0.1, port 70000",
        ),
        ([RUN, "usedFor drinkin"], "Did you mean 'drinking'"),
        ([RUN, "usedFor drinking", "--edit", "mug red"], "must be + or -"),
        (
            [RUN, "usedFor drinking", "--scene", "4000"],
            "scene must be 0 to 3999, got 4000",
        ),
        ([RUN, "usedFor drinking", "--page", "x.pdf"], "must be an .html file"),
        (
            [RUN.replace("choose-subgraph", "full"), "usedFor drinking"],
            "has no grounding network",
        ),
    ],
)
def test_mistakes_are_one_line(arguments, message, capsys):
    assert main(["ask", *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


def test_names_are_escaped_in_the_page(asker):
    found = ask(asker, 'usedFor "<img src=x>"', ['+ mug usedFor "<img src=x>"'])
    assert "<img src=x>" in found.table[0][2]
    text = page(found, "<script>alert(1)</script>", ["<b>"], asker=asker)
    assert "&lt;img src=x&gt;" in text
    assert "<script>" not in text
    assert "<img src=x>" not in text


@pytest.fixture
def served(asker):
    server = make_server(asker, "usedFor drinking")
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield server.server_port
    server.shutdown()
    thread.join()
    server.server_close()


def get(port, path, host=None, **headers):
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request(
        "GET", path, headers={"Host": host or f"127.0.0.1:{port}"} | headers
    )
    response = connection.getresponse()
    return response.status, response.read().decode()


def test_the_served_page_answers_questions_edits_and_mistakes(served):
    status, text = get(served, "/")
    assert status == 200
    assert "which answers" in text
    first = get(served, "/?q=")[1]
    assert "A scene, with" in first
    for link in re.findall(r'href="(/\?q=[^"]+)"', first)[
        :6:2
    ]:  # an example, and values
        assert "Answers in the graph" in get(served, html.unescape(link))[1], link
    status, text = get(
        served, "/?q=usedFor+lighting&edit=-+lamp+usedFor+lighting&scene="
    )
    assert status == 200
    assert "Answers in the graph" in text
    assert "lamp usedFor lighting</td>" not in text
    status, text = get(served, "/?q=usedFor+flyng&scene=3")
    assert status == 200
    assert "Unknown value of usedFor" in text
    assert 'name="scene" value="3"' in text
    assert "A scene, with" not in text, "it is not the one of the message"
    assert "Traceback" not in text
    assert get(served, "/", host="evil.example")[0] == 403
    assert get(served, "/other")[0] == 404
    assert get(served, "http://[")[0] == 403
    assert get(served, "/", host="[::1")[0] == 403
    assert (
        get(served, "/?q=usedFor+drinking", **{"Sec-Fetch-Site": "cross-site"})[0]
        == 403
    )
    assert get(served, "/?q=&scene=" + 5000 * "9")[0] == 200
    assert "A scene, with" in get(served, "/?q=&scene=9999")[1]


def test_the_page_says_what_can_be_asked_of_this_graph_and_this_policy(asker, tmp_path):
    file = tmp_path / "home.csv"
    file.write_text(
        "mug,keepsWarm,coffee\nteapot,keepsWarm,tea\ncan,holds,fish\ncan,isA,tin\n"
    )
    home = Asker(load_agent(RUN), file)
    assert home.words.keys() == {"hasColor", "keepsWarm"}
    assert set(home.words["keepsWarm"]["tea"]) == {"teapot"}
    assert set(home.examples) >= {
        "keepsWarm coffee",
        "keepsWarm coffee and not hasColor blue",
    }
    text = page(None, "", (), asker=home)
    assert "its scenes never show: can," in text
    with pytest.raises(
        UserError, match=r"No scene shows .*: can\. The scenes .*: basket, bell"
    ):
        home.ask("holds fish")
    home.close()


@pytest.mark.parametrize(
    "question",
    [
        "usedFor drinking",
        "something to drink from",
        "I am thirsty. Something to drink from.",
    ],
)
def test_a_film_is_freed_with_its_answer(asker, question):
    """Or else the memory of a page that is asked again and again grows by films of 36 MB."""
    gc.collect()
    gc.disable()
    try:
        images = _shown_images(asker, question)
        assert images
        assert all(image() is None for image in images)
    finally:
        gc.enable()


def _shown_images(asker, question):
    """Return weak references to the images of a page's film."""
    asked = asker.ask(question, scene=1)
    page(asked, question, (), asker=asker)
    return [weakref.ref(frame.large) for frame in asked.film[:-1]]


def test_labels_never_cover_each_other(asker):
    found = ask(asker, "usedFor drinking")
    close = np.array([[0.5, 0.98], [0.51, 0.98], [0.52, 0.99], [0.99, 0.01]])
    labels = place_labels(replace(found, points=close))
    assert [label.answers for label in labels] == sorted(
        [label.answers for label in labels], reverse=True
    )
    for one, other in combinations(labels, 2):
        wide = 50 * (LETTER * (len(one.text) + len(other.text)) + 2 * PADDING) / WIDTH
        apart = abs(one.left - other.left) >= wide - 1e-9
        assert apart or abs(one.top - other.top) >= 100 * LINE / WIDTH - 1e-9
    assert all(0 < label.top < 100 for label in labels)
    named = replace(found, named=(("mug", "mauve"), *found.named[1:]))
    assert [label.text for label in place_labels(named) if not label.right] == [
        "mauve mug"
    ]


def test_a_query_that_takes_long_keeps_nobody_waiting(served, monkeypatch):
    begun, answered = threading.Event(), threading.Event()

    def limited(*_):
        begun.set()
        assert answered.wait(100)
        raise UserError("it needs more than 60 s")

    monkeypatch.setattr("knowarm.asking.answers.limited", limited)
    pages = []
    waiting = threading.Thread(
        target=lambda: pages.append(get(served, "/?q=SELECT+*+%7B%7D")[1])
    )
    waiting.start()
    assert begun.wait(100)
    assert "Answers in the graph" in get(served, "/?q=usedFor+drinking")[1]
    answered.set()
    waiting.join()
    assert "needs more than 60 s" in pages[0]


def test_slow_headers_do_not_block_the_page(served):
    with socket.create_connection(("127.0.0.1", served)) as slow:
        slow.sendall(b"GET / HTTP/1.1\r\n")
        began = time.monotonic()
        assert get(served, "/other")[0] == 404
        assert time.monotonic() - began < 0.9, "the other one has a second per line"


def test_an_idle_connection_does_not_block_the_page(served):
    with socket.create_connection(("127.0.0.1", served)):
        assert get(served, "/other")[0] == 404


def test_scenes_of_families_show_what_looks_like_the_names_of_the_network():
    config = experiment_config("irb120-families-answers-distil")
    spec = GroundingSpec.of(config.env, config.knows.grounding)
    families = Asker(SimpleNamespace(network=SimpleNamespace(spec=spec), config=config))
    answers = families.answers("usedFor drinking")
    shown = families._shown[families.scene([answers])]
    assert answers.satisfies[shown].sum() == 1
    families.close()
