"""The benchmark: frozen suites, rows that verify, controls, leaderboard."""

import copy
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from safetensors.numpy import save_file

from knowarm.benchmark.freezing import freeze
from knowarm.benchmark.leaderboard import left_out, read_rows, tables, write_leaderboard
from knowarm.benchmark.policies import Entrant, entrant, is_safe
from knowarm.benchmark.rows import read_row, run_suite, shuffled, verify
from knowarm.benchmark.suites import parse_suite, read_suite, suite_names
from knowarm.cli.main import main
from knowarm.errors import UserError
from knowarm.experiment.run_folder import RunFolder
from knowarm.knowledge.formats import read_graph
from knowarm.questions import find_rows
from knowarm.reading import write_json
from knowarm.world.agents import SCRIPTED_AGENTS
from knowarm.world.agents.protocol import Batch
from knowarm.world.config import questions_of
from knowarm.world.envs.vector_env import ArmVectorEnv
from tests.source_tree import ROOT
from tests.thorough import thorough

TABLE = "irb120, fixed colours"
PUBLISHED = {
    "choose-v1": "03407d9ea3703743a1fab0cf134f470a207d520690830589da9084593b307b40",
    "damaged-graph-v1": "feef0edf7d7632d47a892cfaeb3c31674ee1c594201da47bbb7faed4517b5e07",
    "pick-and-place-v1": "23f4c4316db74bbe87f645d516ca0d9cddcbb05e13d42036079c6110790edddf",
    "reach-v1": "116b8adf5475328f4d299923464cab0f7beddbd142dae4c89462a30c04b005e9",
}


def test_published_suites_do_not_change():
    assert {name: read_suite(name).digest for name in suite_names()} == PUBLISHED


@pytest.mark.parametrize("name", sorted(PUBLISHED))
def test_the_frozen_questions_have_their_frozen_answers(name):
    for cell in read_suite(name).cells.values():
        table, episodes = questions_of(cell.env), cell.episodes
        if table is None:
            assert set(episodes.question) == {""}
            continue
        rows = {query.name: row for row, query in enumerate(table.queries)}
        asked = find_rows("query", episodes.question, rows)
        names = [name for name, _ in table.facets]
        first = np.array([names.index(name) for name in cell.env.targets])
        shown = first[episodes.objects] + episodes.colours
        assert (
            table.satisfies[asked[:, None], shown] == [True, False, False, False]
        ).all()


TRAYS = {
    "irb120-place-S1": "the blue tray is the garden; the green tray is the kitchen; the red tray "
    "is the living room",
    "tiago-named-S1": "the destination is the garden; the pink tray is the garden; the cyan tray "
    "is the living room",
}
"""What is told of the first episode."""


@pytest.mark.parametrize("name", sorted(TRAYS))
def test_the_frozen_trays_are_what_they_were(name):
    cell = read_suite("pick-and-place-v1").cells[name]
    env = ArmVectorEnv(replace(cell.env, image_size=8), 1)
    env.reset(options={"episodes": cell.episodes[:1]})
    assert env.running.instruct(0) == f"isMadeOf wood and hasColor pink; {TRAYS[name]}"


@pytest.mark.parametrize("name", ["choose-v1", "reach-v1"])
def test_the_fixed_lists_still_reach_what_they_reached(name):
    for cell in list(read_suite(name).cells.values())[::6]:
        # A list reads no image
        env = ArmVectorEnv(replace(cell.env, image_size=8), 100)
        played = run_agent(entrant("open-loop").make(cell, env), env, cell.episodes)
        assert abs(played.mean() - cell.reference["open-loop"]) <= 0.01


def run_agent(agent, env, episodes):
    from knowarm.world.agents.play import play

    return play(agent, env, episodes).success


@pytest.fixture(scope="module")
def small():
    """A suite of two cells with few episodes."""
    suites = [
        read_suite("reach-v1").cells["irb120-fixed"],
        read_suite("choose-v1").cells["irb120-S1"],
    ]
    cells = []
    for cell in suites:
        few = copy.copy(cell)
        object.__setattr__(few, "episodes", cell.episodes[:12])
        cells.append(few)
    return freeze("reach-v1", "small", cells, training_seeds=2, control_episodes=6)


def test_a_suite_reads_back_what_was_frozen(small):
    again = parse_suite(*small.data)
    assert again.digest == small.digest
    for name, cell in small.cells.items():
        assert again.cells[name].env == cell.env
        np.testing.assert_array_equal(
            again.cells[name].episodes.objects, cell.episodes.objects
        )


def playing(name):
    """A scripted agent, declared as two seeds of a policy that uses images and words."""
    make = entrant(name).make
    return [
        Entrant(spec=name, make=make, inputs=("image", "words"), seed=i) for i in (0, 1)
    ]


@pytest.fixture(scope="module")
def row(small):
    """A row of the oracle, declared as a policy that uses images."""
    return run_suite(small, playing("oracle"), name="oracle")


@pytest.fixture
def stored(row, small, tmp_path, monkeypatch):
    """The row in a file, and the small suite in place of the shipped one."""
    monkeypatch.setattr("knowarm.benchmark.rows.read_suite", lambda name: small)
    monkeypatch.setattr("knowarm.benchmark.leaderboard.read_suite", lambda name: small)
    path = tmp_path / "rows" / "row.json"
    path.parent.mkdir()
    write_json(path, row)
    return path


def test_a_row_has_score_controls_and_intervals(row):
    cell = row["cells"]["irb120-S1"]
    assert cell["success"]["mean"] > 0.9
    assert cell["success"]["low"] < cell["success"]["high"]
    assert set(cell["controls"]) == {"open-loop", "black", "frozen", "shuffled query"}
    assert cell["right"]["mean"] > 0.9
    assert "shuffled query" not in row["cells"]["irb120-fixed"]["controls"]


def test_a_row_verifies_and_another_policy_does_not(stored):
    row = read_row(stored)
    verify(row, playing("oracle"))
    with pytest.raises(
        UserError, match=r"policy\.seeds: the row says \[0, .* has \[None"
    ):
        verify(row, [entrant("oracle")] * 2)
    with pytest.raises(UserError, match=r"policy\.digests"):
        verify(row, playing("oracle")[:1])
    one_cell = row | {"cells": {"irb120-fixed": row["cells"]["irb120-fixed"]}}
    with pytest.raises(UserError, match=r"the same controls \(black\)"):
        verify(without_black(one_cell), playing("oracle"))
    with pytest.raises(
        UserError, match=r"cells\.irb120-fixed\.outcomes\[0\]\.policy\.success"
    ):
        verify(one_cell, playing("zero"))


def test_a_row_is_of_different_seeds_of_one_policy(small):
    with pytest.raises(UserError, match="Give each seed once, got zero, zero"):
        run_suite(small, [entrant("zero")] * 2, name="x")
    with pytest.raises(UserError, match=r"must have equal inputs, got \('image'"):
        run_suite(small, [playing("oracle")[0], entrant("zero")], name="x")


def test_a_row_says_how_long_its_policy_was_trained(tmp_path):
    run = shutil.copytree(ROOT / "zoo/irb120-full-fast", tmp_path / "run")
    assert "irb120-full-fast, 1,500,000 steps" in entrant(str(run)).training
    (run / "checkpoints/latest").mkdir()
    write_json(run / "checkpoints/latest/meta.json", {"facts": {"step": 1000}})
    assert "irb120-full-fast, 1,000 steps" in entrant(str(run)).training


def without_black(row):
    row = copy.deepcopy(row)
    for cell in row["cells"].values():
        for outcome in cell["outcomes"]:
            del outcome["black"]
    return row


def test_episodes_that_are_left_out_are_noticed(stored):
    row = json.loads(stored.read_text())
    for outcome in row["cells"]["irb120-S1"]["outcomes"]:
        outcome["policy"]["success"] = "ff"  # 8 of 12 episodes
    stored.write_text(json.dumps(row))
    with pytest.raises(UserError, match="outcomes of 8 instead of 12 episodes"):
        read_row(stored)


@pytest.mark.parametrize(
    ("where", "words"),
    [
        (("cells", "irb120-S1", "success", "mean"), "cells.irb120-S1.success.mean"),
        (("cells", "irb120-S1", "controls", "black"), "cells.irb120-S1.controls.black"),
        (("summary", TABLE, "success", "low"), f"summary.{TABLE}.success.low"),
    ],
)
def test_a_changed_number_is_named(stored, where, words):
    row = json.loads(stored.read_text())
    place = row
    for key in where[:-1]:
        place = place[key]
    place[where[-1]] = 0.123
    stored.write_text(json.dumps(row))
    with pytest.raises(UserError, match=words.replace(".", r"\.")):
        read_row(stored)


def test_rows_of_another_suite_or_format_are_refused(stored):
    row = json.loads(stored.read_text())
    stored.write_text(json.dumps(row | {"digest": "0"}))
    with pytest.raises(UserError, match=r"^(?!.*damaged).*digests differ"):
        read_row(stored)
    for wrong in ({"cells": []}, {"name": 7}, {"policy": {}}):
        stored.write_text(json.dumps(row | wrong))
        with pytest.raises(UserError, match="damaged"):
            read_row(stored)
    stored.write_text(json.dumps(row | {"policy": row["policy"] | {"inputs": [1]}}))
    with pytest.raises(UserError, match="damaged"):
        read_row(stored)
    for other in (0, 1, True, 2.0, "2"):
        stored.write_text(json.dumps(row | {"format": other}))
        with pytest.raises(UserError, match=r"no row .*Measure it again"):
            read_row(stored)
    del row["cells"]["irb120-S1"]["outcomes"]
    stored.write_text(json.dumps(row))
    with pytest.raises(UserError, match="damaged"):
        read_row(stored)


FORGED = {
    "a control is left out": (
        ("cells", "irb120-S1", "outcomes", 0, "black"),
        None,
        "black",
    ),
    "an unknown control": (
        ("cells", "irb120-fixed", "outcomes", 1, "luck"),
        {},
        "luck",
    ),
    "an unknown input": (
        ("policy", "inputs"),
        ["image", "words", "telepathy"],
        "telepathy",
    ),
    "fewer inputs hide controls": (("policy", "inputs"), [], "black"),
    "seeds": (("policy", "seeds"), [0], "differ in length"),
    "digests": (("policy", "digests"), ["", "", ""], "differ in length"),
    "one policy twice": (("policy", "digests"), ["ab", "ab"], "one policy twice"),
    "no policy": (("policy", "specs"), [], "no policy"),
    "no name": (("name",), "", "no name"),
    "another field": (("extra",), 1, "lacks, or has, extra"),
    "no cells": (("cells",), {}, "no cells"),
    "a heading as name": (("name",), "x\n# Winner", "is not one line"),
    "a long training": (("policy", "training"), "x" * 4_000_000, "is not one line"),
}


@pytest.mark.parametrize("forged", FORGED)
def test_forged_declarations_are_refused(row, stored, forged):
    """The figures of each follow from its episodes, so that nothing else finds it."""
    (*path, last), value, words = FORGED[forged]
    changed = place = copy.deepcopy(row)
    for key in path:
        place = place[key]
    if value is None:
        del place[last]
    else:
        place[last] = value
    stored.write_text(json.dumps(changed))
    with pytest.raises(UserError, match=words) as error:
        read_row(stored)
    assert len(str(error.value)) < 500


def test_one_policy_given_several_times_is_one_seed(small):
    make = entrant("oracle").make
    copies = [
        Entrant(spec=f"copy-{i}", make=make, seed=i, digest=str(i))
        for i in range(thorough(3, 5))
    ]
    many, one = (run_suite(small, each, name="x") for each in (copies, copies[:1]))
    for name, cell in many["cells"].items():
        for end in ("mean", "low", "high"):
            assert cell["success"][end] == one["cells"][name]["success"][end]


def test_cells_that_share_their_episodes_count_once(small):
    cell = small.cells["irb120-fixed"]
    twins = {name: replace(cell, name=name) for name in ("one", "two", "three")}
    row = run_suite(replace(small, cells=twins), [entrant("zero")], name="x")
    of_cell, of_table = (
        row["cells"]["one"]["success"],
        row["summary"][cell.table]["success"],
    )
    assert of_table == of_cell


def test_a_policy_that_cannot_play_a_cell_plays_none(small):
    lines = []
    run = entrant(str(ROOT / "zoo/irb120-full-fast"))
    with pytest.raises(UserError, match="was trained for irb120 and reach"):
        run_suite(small, [run], name="x", report=lines.append)
    assert lines == []


@pytest.mark.parametrize("tolerance", [float("nan"), -1.0, 0.1, 1.0, 2.0, float("inf")])
def test_a_tolerance_that_accepts_anything_is_refused(row, small, stored, tolerance):
    with pytest.raises(UserError, match="tolerance must lie from 0 to below"):
        verify(row, playing("zero"), tolerance=tolerance)


@pytest.mark.parametrize(
    "file", ["config.json", "provenance.json", "knowledge.safetensors"]
)
def test_the_digest_of_a_run_covers_what_it_declares_and_knows(tmp_path, file):
    run = shutil.copytree(ROOT / "zoo/irb120-full-fast", tmp_path / "run")
    before = entrant(str(run)).digest
    if file == "knowledge.safetensors":
        save_file({"table": RunFolder(run).knowledge() + 1}, run / file)
    else:
        (run / file).write_text((run / file).read_text() + " ")
    assert entrant(str(run)).digest != before


def test_a_row_chooses_no_model_to_open(tmp_path):
    run = str(ROOT / "zoo/irb120-full-fast")
    assert is_safe(run)
    assert is_safe("oracle")
    (tmp_path / "a.onnx").write_text("")
    (tmp_path / "contract.json").write_text("")
    for spec in (
        str(tmp_path),
        str(tmp_path / "a.onnx"),
        "m:Name",
        "ws://h",
        "\\\\h\\s",
        "//h/s",
    ):
        assert not is_safe(spec)


def test_a_folder_that_a_row_may_name_is_played_as_a_run(tmp_path, monkeypatch):
    """Whatever else a stranger put into it, or beside it under its name with a prefix."""
    run = shutil.copytree(ROOT / "zoo/irb120-full-fast", tmp_path / "run")
    monkeypatch.chdir(tmp_path)
    for folder in (run, tmp_path / "seen:run"):
        folder.mkdir(exist_ok=True)
        (folder / "contract.json").write_text("{}")
    for spec in ("run", "seen:run"):
        assert is_safe(spec)
        assert "irb120-full-fast" in entrant(spec).training


def test_the_leaderboard_ranks_by_intervals_and_shows_controls(stored, small):
    weak = run_suite(small, [entrant("zero")], name="zero <b>")
    write_json(stored.parent / "zero.json", weak)
    partial = weak | {"summary": {TABLE: {"cells": []}}}
    assert left_out([weak, partial]) == [f"zero <b> lacks cells of {TABLE}"]
    table, asked = tables(read_rows(stored.parent))
    assert not table["has_query_gain"]  # of a task without queries
    # The oracle does not read them.
    assert [line["query_gain"] for line in asked["lines"]] == ["+0.0 [+0.0, +0.0]", "–"]
    assert [(line["name"], line["rank"]) for line in table["lines"]] == [
        ("oracle", 1),
        ("zero <b>", 2),
    ]
    # Zero sees nothing
    assert [line["is_ranked"] for line in table["lines"]] == [
        True,
        False,
    ]
    html, markdown = write_leaderboard(
        read_rows(stored.parent), stored.parent / "page.html"
    )
    assert "zero &lt;b&gt;" in html.read_text()
    for file in (html, markdown):  # they are not found, and the page says so
        assert "copies of one policy that differ in an episode" in file.read_text()
    assert ">blind</th>" in html.read_text()
    # "binding" is what an evaluation measures with questions of other visible objects.
    assert ">query gain [points]</th>" in html.read_text()
    assert " query gain | training |" in markdown.read_text()
    assert "binding" not in html.read_text() + markdown.read_text()
    assert "| 1 | oracle | " in markdown.read_text()
    first = markdown.read_text().split("\n## ")[0]  # the best policy of each table
    assert "| oracle |" in first
    assert "zero" not in first
    assert "| – | zero &#60;b&#62; |" in markdown.read_text()


def test_a_policy_below_what_is_reached_blind_has_no_rank(stored, small):
    lists = {name: entrant(name).make for name in ("zero", "open-loop", "oracle")}
    rows = [
        run_suite(small, [Entrant(spec=name, make=make)], name=name)
        for name, make in lists.items()
    ]
    for row in rows:  # blind, a fixed list solves every second episode
        for summary in row["summary"].values():
            summary["controls"]["open-loop"] = 0.5
    for table in tables(rows):
        ranked = {line["name"]: line["is_ranked"] for line in table["lines"]}
        assert ranked == {"oracle": True, "zero": False, "open-loop": False}
        assert table["lines"][0]["name"] == "oracle"
        assert all(line["sees"] for line in table["lines"])


def test_what_a_network_sees_is_solved_as_a_reference(stored, small):
    run = "zoo/irb120-choose-answers-fast"
    seen, policy = entrant(f"seen:{run}"), entrant(run)
    assert is_safe(seen.spec)
    assert not is_safe("seen:ws://h")
    assert {*seen.inputs} - {*policy.inputs} == {"simulator"}
    asked = replace(small, cells={"irb120-S1": small.cells["irb120-S1"]})
    row = run_suite(asked, [seen], name="seen")
    verify(row, [seen])
    with pytest.raises(UserError, match=r"policy\.(inputs|training)"):
        verify(row, [policy])
    (cell,) = row["cells"].values()
    assert cell["success"]["mean"] > 0.6
    assert cell["controls"]["black"] < 0.2
    (table,) = tables([row])
    assert not table["lines"][0]["is_ranked"], "it knows the joint angles"
    reach = small.cells["irb120-fixed"]
    env = ArmVectorEnv(reach.env, 1)
    with pytest.raises(UserError, match="no grounding network"):
        entrant("seen:zoo/irb120-full-fast").make(reach, env)


class Noting:
    """A policy that notes what it receives."""

    def reset(self, batch: Batch):
        self.batch = batch

    def act(self, observations):
        self.image = observations["image"]
        return np.zeros((self.batch.size, len(self.batch.joints)), np.int64)


def test_a_policy_receives_image_joints_and_query(small):
    cell, policy = small.cells["irb120-S1"], Noting()
    env = ArmVectorEnv(cell.env, 12)
    run_agent(policy, env, cell.episodes)
    assert policy.batch.queries == tuple(cell.episodes.question)
    assert policy.batch.conditions[0][0][1] in policy.batch.queries[0]
    assert policy.image.shape == (12, 64, 64, 3)
    queries = shuffled(policy.batch).queries
    assert sorted(queries) == sorted(policy.batch.queries)
    assert queries != policy.batch.queries


def test_controls_exchange_the_queries_of_their_episodes_alone(small):
    told = []

    class Told(Noting):
        def reset(self, batch):
            super().reset(batch)
            told.append(sorted(batch.names))

    policy = Entrant(spec="x", make=lambda cell, env: Told(), inputs=("image", "words"))
    run_suite(small, [policy], name="x", cells=["irb120-S1"])
    asked = small.cells["irb120-S1"].episodes.question
    first = sorted(asked[:6])
    assert len(set(first)) > 1
    # Two halves by the policy, then black, frozen and shuffled
    assert told == [first, sorted(asked[6:]), first, first, first]


@pytest.fixture(scope="module")
def damaged():
    """A suite of one cell with a damaged graph and few episodes."""
    cell = copy.copy(read_suite("damaged-graph-v1").cells["irb120-missing"])
    object.__setattr__(cell, "episodes", cell.episodes[:4])
    return freeze(
        "damaged-graph-v1", "small", [cell], training_seeds=1, control_episodes=4
    )


def test_damaged_graphs_are_played_with_the_episodes_of_choose():
    whole, graph = read_suite("choose-v1").cells, read_graph("objects")
    for name, cell in read_suite("damaged-graph-v1").cells.items():
        intact = whole[f"{cell.env.robot}-S1"]
        assert cell.env == intact.env
        np.testing.assert_array_equal(cell.episodes.question, intact.episodes.question)
        np.testing.assert_array_equal(
            cell.episodes.positions, intact.episodes.positions
        )
        np.testing.assert_array_equal(cell.open_loop, intact.open_loop)
        removed, added = set(graph) - set(cell.graph), set(cell.graph) - set(graph)
        assert 45 <= len(removed) <= 60  # about 30 % of the triples about 25 objects
        assert len(added) == (0 if name.endswith("missing") else len(removed))
        assert cell.graph.entities == graph.entities


def test_a_policy_receives_the_damaged_graph_and_its_control_does_not(
    damaged, monkeypatch
):
    received = []

    class Reading(Noting):
        inputs = ("image", "words", "graph")

        def reset(self, batch):
            super().reset(batch)
            received.append(batch.graph)

    monkeypatch.setattr(
        "tests.benchmark.test_benchmark.Reading", Reading, raising=False
    )
    made = entrant("tests.benchmark.test_benchmark:Reading")
    row = run_suite(damaged, [made], name="reading")
    cell = damaged.cells["irb120-missing"]
    controls = ["open-loop", "black", "frozen", "shuffled query", "intact graph"]
    assert list(row["cells"][cell.name]["controls"]) == controls
    assert received == [cell.graph] * 4 + [None]


def test_an_agent_knows_the_damaged_graph_in_its_cells(damaged):
    trained = entrant(str(ROOT / "zoo/irb120-choose-subgraph-fast"))
    cell = damaged.cells["irb120-missing"]
    tables = [
        trained.make(each, None).recognition.knowledge.numpy()
        for each in (cell, replace(cell, graph=None))
    ]
    changed = (tables[0] != tables[1]).any(axis=1)
    assert 0.2 < changed.mean() < 1
    own = entrant(str(ROOT / "zoo/irb120-choose-answers-fast"))
    assert set(own.controls) == {"shuffled graph"}


@pytest.mark.parametrize(
    "wrong", [np.zeros((3, 6)), np.full((12, 6), 7), np.zeros((12, 5), int), None]
)
def test_wrong_actions_are_refused(small, wrong):
    cell, policy = small.cells["irb120-fixed"], Noting()
    policy.act = lambda observations: wrong
    with pytest.raises(
        UserError, match="actions must be integers from 0 to 6 of shape"
    ):
        run_agent(policy, ArmVectorEnv(cell.env, 12), cell.episodes)


@pytest.mark.parametrize(
    "spec",
    ["nothing", "no_module:Name", "json:Name", "json:JSONDecoder", "random:sample"],
)
def test_unknown_policies_are_refused(spec):
    with pytest.raises(UserError):
        entrant(spec)


def test_a_run_plays_only_cells_of_its_robot_and_task(small):
    trained = entrant(str(ROOT / "zoo/irb120-full-fast"))
    trained.make(small.cells["irb120-fixed"], None)
    with pytest.raises(UserError, match="was trained for irb120 and reach"):
        trained.make(small.cells["irb120-S1"], None)


def test_what_a_network_sees_is_solved_whatever_has_to_be_done_with_it():
    """A network trained to sort is played where objects are picked, and its policy is not."""
    run = "zoo/tiago-choose-sort-answers-seen"
    cells = read_suite("pick-and-place-v1").cells
    picking = cells["tiago-pick-S1"]
    env = ArmVectorEnv(picking.env, 4)
    agent = entrant(f"seen:{run}").make(picking, env)
    assert run_agent(agent, env, picking.episodes[:4]).sum() >= 2
    with pytest.raises(UserError, match="was trained for tiago"):
        entrant(f"seen:{run}").make(cells["irb120-pick-S1"], None)


def test_the_commands(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(ROOT / "examples/benchmark")
    short = freeze_short()
    for module in ("rows", "leaderboard"):
        monkeypatch.setattr(
            f"knowarm.benchmark.{module}.read_suite", lambda name: short
        )
    monkeypatch.setattr("knowarm.benchmark.command.read_suite", lambda name: short)
    row, page = tmp_path / "rows/row.json", tmp_path / "page.html"
    row.parent.mkdir()
    assert main(["benchmark", "show"]) == 0
    assert main(["benchmark", "run", "reach-v1", "--policy", "--out", str(row)]) == 2
    assert "--policy needs a policy" in capsys.readouterr().err
    few = [
        "benchmark",
        "run",
        "reach-v1",
        "--policy",
        "oracle",
        "--out",
        str(row),
        "--trial",
    ]
    assert (main([*few, "2"]), main([*few, "0"]), row.exists()) == (0, 2, False)
    assert (
        main(
            [
                "benchmark",
                "run",
                "reach-v1",
                "--policy",
                "my_policy:Random",
                "--out",
                str(row),
            ]
        )
        == 0
    )
    # A row must not choose code to import
    assert main(["benchmark", "verify", str(row)]) == 2
    assert main(["benchmark", "verify", str(row), "--no-play"]) == 0
    assert main(["benchmark", "verify", str(row), "--policy", "my_policy:Random"]) == 0
    assert main(["benchmark", "table", str(row.parent), "--out", str(page)]) == 0
    assert (
        main(["benchmark", "run", "reach-v1", "--policy", "oracle", "--cells", "panda"])
        == 2
    )
    assert main([*few[:-3], "--out", str(tmp_path)]) == 2
    shown = capsys.readouterr()
    assert "played again with the same outcomes" in shown.out
    assert "names code, a server or a model (my_policy:Random)" in shown.err
    assert f"Cannot write {tmp_path}" in shown.err
    assert page.exists()


def freeze_short():
    """A suite of one cell with four episodes."""
    cell = copy.copy(read_suite("reach-v1").cells["irb120-fixed"])
    object.__setattr__(cell, "episodes", cell.episodes[:4])
    return freeze("reach-v1", "short", [cell], training_seeds=1, control_episodes=2)


@pytest.mark.parametrize("name", SCRIPTED_AGENTS)
def test_scripted_agents_enter_with_the_inputs_that_they_name(name):
    assert entrant(name).inputs == SCRIPTED_AGENTS[name].kind.inputs
