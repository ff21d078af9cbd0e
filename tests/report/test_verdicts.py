"""Verdicts on studies whose truth is known."""

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from knowarm.config import to_dict
from knowarm.report.blocks import Figure, Verdict, flat
from knowarm.report.collect import collect
from knowarm.report.model import StudyData, TaskData
from knowarm.report.pages import inputs
from knowarm.report.verdicts.claims import claims, scores
from knowarm.report.verdicts.knowledge import answer, finding, findings
from knowarm.report.verdicts.learning import learning_verdict, vision_verdict
from knowarm.report.write import build_pages
from knowarm.statistics import area_under_curve, share_difference, wilson
from tests.report.synthetic_study import (
    LABEL,
    Size,
    Truth,
    edit_summary,
    redraw,
    write_run,
    write_study,
)

LIGHT = Size(points=12, tables=False)

AGENTS = ("bm", "full", "wide", "zeros", "random", "shuffled", "onehot")
EQUAL = dict.fromkeys(AGENTS, 0.75)
REAL = dict.fromkeys(AGENTS, 0.5) | {"full": 0.75}
NOTHING = dict.fromkeys(("bm", "full", "wide", "random"), 0.6)
SCENE = dict.fromkeys(("wide", "zeros", "random", "shuffled", "onehot"), 0.4)
TARGET = dict.fromkeys(
    ("target-zeros", "target-random", "target-shuffled", "target-onehot"), 0.4
)
LOW = {"bm": 0.4, "target-zeros": 0.4, **SCENE}
PLUS = dict.fromkeys(("wide", "zeros", "random+", "shuffled+", "onehot+"), 0.4)
BOTH = LOW | {"target": 0.8, "target-onehot": 0.8}
MEANING, SIZE, INPUT = (
    "knowledge matters",
    "size may explain it",
    "input without meaning",
)


def decided(
    folder: Path, success: dict[str, float], seeds: int = 5, **truth
) -> list[Verdict]:
    """Findings on success of every subject of one study."""
    study = collect(
        write_study(folder, Truth(success=success, **truth), seeds=seeds, size=LIGHT)
    )
    return [each.verdict() for each in findings(study.tasks[0], claims(study))]


def words(found: Verdict) -> set[str]:
    """Words of the sentence, without the title of the task."""
    return set(
        found.sentence.split(": ", 1)[1].replace(",", " ").replace(".", " ").split()
    )


def some(*agents: str) -> dict[str, float]:
    return {agent: REAL[agent] for agent in agents}


@pytest.mark.parametrize(
    ("success", "kind", "named", "unnamed"),
    [
        (
            REAL,
            MEANING,
            {"bm", "wide", "onehot"},
            {"partial", "target", "wrong-object"},
        ),
        (EQUAL | {"bm": 0.5}, SIZE, {"wide"}, {"partial", "target", "wrong-object"}),
        (
            EQUAL | dict.fromkeys(("bm", "wide", "zeros"), 0.5),
            INPUT,
            {"random"},
            {"partial"},
        ),
        (EQUAL | {"full": 0.4}, "worse", {"bm"}, set()),
        (NOTHING, "no advantage", {"bm"}, set()),
        # Registered
        (
            some("bm", "full"),
            "size not excluded",
            {"wide", "zeros"},
            set(),
        ),
        (
            some("bm", "full", "wide", "zeros"),
            "meaning not tested",
            {"shuffled"},
            set(),
        ),
        (some("full", "wide"), "no baseline", set(), {"bm"}),
        (some("bm", "wide"), "nothing to compare", set(), set()),
        (some("full"), "nothing to compare", set(), set()),
        (
            {**some("bm", "wide"), "full": 0.8, "wrong-object": 0.5},
            MEANING,
            {"wrong-object"},
            {},
        ),
        (
            {**some("bm", "wide"), "full": 0.8, "wrong-object": 0.8},
            INPUT,
            {"wrong-object"},
            {},
        ),
        (
            some("bm", "full", "zeros", "shuffled"),
            MEANING,
            set(),
            {"wide", "random", "onehot"},
        ),
        # A privileged agent is judged by the controls of its scope.
        (BOTH, INPUT, {"target-onehot"}, set(SCENE)),
        (BOTH | {"target-onehot": 0.5}, MEANING, set(), set(SCENE)),
        (
            LOW | {"target": 0.8},
            "meaning not tested",
            {*TARGET} - {"target-zeros"},
            {"shuffled"},
        ),
        (
            SCENE | {"bm": 0.4, "target": 0.8},
            "size not excluded",
            {"target-zeros"},
            set(SCENE),
        ),
        (TARGET | {"bm": 0.4, "target": 0.8}, MEANING, set(TARGET), set()),
        (
            TARGET | {"bm": 0.4, "target": 0.8, "target-random": 0.8},
            INPUT,
            set(),
            set(),
        ),
        (TARGET | {"bm": 0.4, "target": 0.8, "target-zeros": 0.8}, SIZE, set(), set()),
        # The vector of ``full+`` is longer than that of ``full``: each has its own controls.
        (
            PLUS | {"bm": 0.4, "full+": 0.8, "random": 0.4},
            MEANING,
            {*PLUS, "(norm"},
            set(),
        ),
        # A learned vector has more parameters.
        (REAL | {"learned": 0.9}, MEANING, {"learned", "(parameters"}, set()),
    ],
)
def test_the_verdict_on_an_agent(tmp_path, success, kind, named, unnamed):
    (result,) = decided(tmp_path, success)
    assert result.kind == kind
    assert words(result) >= set(named)
    assert not words(result) & set(unnamed)


@pytest.mark.parametrize("seeds", [1, 2])
def test_few_seeds_allow_no_claim_however_large_the_difference(tmp_path, seeds):
    (result,) = decided(
        tmp_path, SCENE | {"bm": 0.1, "full": 0.95}, seeds, spread=0.001
    )
    assert result.kind == "too few seeds"
    assert "cannot be decided" in result.sentence


def test_two_subjects_are_judged_apart_and_by_controls_of_their_scope(tmp_path):
    success = REAL | {"target": 0.9, "target-onehot": 0.9, "target-zeros": 0.4}
    scene, target = decided(tmp_path, success)
    assert (scene.kind, target.kind) == (MEANING, INPUT)
    assert not {"target", "target-onehot"} & words(scene)
    assert any(
        "zeros" in r and "scope scene instead of target" in r for r in target.reasons
    )


@pytest.mark.parametrize(
    ("success", "roles", "kind"),
    [
        ({"toy": 0.5}, {"toy": "content_control"}, MEANING),
        ({"toy": 0.8}, {"toy": "content_control"}, INPUT),
        ({"toy": 0.5}, {}, "meaning not tested"),
    ],
)
def test_the_role_of_an_unregistered_agent_is_read_from_its_config(
    tmp_path, success, roles, kind
):
    (result,) = decided(
        tmp_path, {"bm": 0.5, "full": 0.8, "wide": 0.5} | success, roles=roles
    )
    assert result.kind == kind
    assert ("toy" in words(result)) == bool(roles)


def test_every_role_can_come_from_the_config(tmp_path):
    success = {"none": 0.5, "mine": 0.8, "large": 0.5, "other": 0.5}
    roles = ("baseline", "knowledge", "capacity_control", "content_control")
    (result,) = decided(tmp_path, success, roles=dict(zip(success, roles, strict=True)))
    assert result.kind == MEANING
    assert words(result) >= set(success)


@pytest.mark.parametrize(
    ("control", "stored", "reason"),
    [
        ("random", {"knowledge": {"dim": 300}}, "knowledge width 300 instead of 150"),
        ("random", {"knowledge": {"norm": 9.0}}, "norm 9 instead of"),
        ("random", {"knowledge": {"dim": None}}, "knowledge width unknown"),
        (
            "random",
            {"parameter_counts": {"total": 900_000}},
            "parameters 900,000 instead of",
        ),
        # 202 visual features
        (
            "wide",
            {"parameter_counts": {"image": 246_186}},
            "parameters of the image encoder",
        ),
    ],
)
def test_a_control_of_another_size_is_described_and_named(
    tmp_path, control, stored, reason
):
    success = {"bm": 0.5, "full": 0.8, "zeros": 0.5, "onehot": 0.5, control: 0.8}
    (result,) = decided(tmp_path, success, sizes={control: stored})
    assert result.kind == "knowledge matters"
    assert f"Not counted as controls: {control} ({reason}" in result.sentence
    assert control not in result.sentence.split("Not counted")[0].split(": ", 1)[1]
    described = [r for r in result.reasons if f"against {control}:" in r]
    assert described
    assert all("descriptive only" in r and reason in r for r in described)


def test_a_claim_behind_a_closed_gate_is_not_tested(tmp_path):
    # full beats zeros by far, but not the baseline.
    truth = EQUAL | {"zeros": 0.1}
    paths = write_study(tmp_path, Truth(success=truth), seeds=6, size=LIGHT)
    decided = claims(collect(paths))
    zeros = next(
        c for c in decided if c.second.agent == "zeros" and c.outcome == "success"
    )
    assert zeros.comparison.p_value < 1e-4
    assert zeros.verdict == "not tested"


def test_an_adjusted_p_is_never_below_the_plain_one(tmp_path):
    paths = write_study(tmp_path, Truth(success=REAL), seeds=5, size=LIGHT)
    for claim in claims(collect(paths)):
        if claim.adjusted_p is not None:
            assert claim.adjusted_p >= claim.comparison.p_value
            if claim.verdict in ("better", "worse"):
                interval = claim.comparison.difference
                assert interval.low > 0 or interval.high < 0


def test_without_any_effect_at_most_one_study_in_twenty_claims_one(tmp_path):
    quiet = {"no advantage", "too few seeds"}
    truth, loud = Truth(success=NOTHING), 0
    study = collect(write_study(tmp_path, truth, seeds=3, size=LIGHT))
    for number in range(100):
        drawn = redraw(study, truth, seed=3_000 + number, size=LIGHT)
        found, task = claims(drawn), drawn.tasks[0]
        loud += any(
            finding(task, found, name).kind not in quiet
            for name in ("success", "speed")
        )
    assert loud <= 5


def test_splits_are_named_once_for_the_tasks_that_share_them():
    subject = SimpleNamespace(name="full")

    def said(tasks: dict[str, tuple[str, ...]]) -> str:
        found = [
            SimpleNamespace(
                task=SimpleNamespace(title=title),
                subject=subject,
                outcome=split,
                kind="understood",
            )
            for title, splits in tasks.items()
            for split in splits
        ]
        return answer(found, 2).sentence

    understood = "the query is understood"
    assert f"full: on S1 and S4 of A {understood}" in said({"A": ("S1", "S4")})
    assert f"on S1 and S4 of both tasks {understood}" in said(
        {"A": ("S1", "S4"), "B": ("S1", "S4")}
    )
    assert f"on S1 of A and S4 of B {understood}" in said({"A": ("S1",), "B": ("S4",)})


def test_the_answer_names_outcomes_that_differ():
    tasks, subject = (
        [SimpleNamespace(title=each) for each in "AB"],
        SimpleNamespace(name="full"),
    )

    def said(speed_on_b: str) -> str:
        kinds = {("success", 0): "no advantage", ("success", 1): "no advantage"}
        kinds |= {("speed", 0): "no advantage", ("speed", 1): speed_on_b}
        found = [
            SimpleNamespace(
                task=tasks[task], subject=subject, outcome=outcome, kind=kind
            )
            for (outcome, task), kind in kinds.items()
        ]
        return answer(found, 2).sentence

    one = "full: on both tasks no advantage over the baseline is shown."
    assert said("no advantage").endswith(one)
    more = said(SIZE)
    assert "full: success after training: on both tasks no advantage" in more
    assert "mean success during training: on A no advantage" in more
    assert "; on B better than the baseline, but not than a network as large." in more


def test_the_first_page_states_what_is_found_on_every_tested_outcome(tmp_path):
    truth = Truth(success=some("bm", "full", "wide"))
    study = collect(write_study(tmp_path, truth, seeds=3, size=LIGHT))
    study.tasks[0].subjects[0].runs[0].interim["success"][:] = (
        0.0  # faster, except for one run
    )
    pages = build_pages(study)
    known = claims(study)
    for outcome in ("success", "speed"):
        sentence = findings(study.tasks[0], known, outcome)[0].sentence
        assert any(
            isinstance(block, Verdict) and block.sentence == sentence
            for block in flat(pages[0].blocks)
        ), outcome


def test_curves_are_compared_as_far_as_every_agent_has_a_run(tmp_path):
    paths = write_study(
        tmp_path, Truth(success={"bm": 0.5, "full": 0.5}), seeds=2, size=LIGHT
    )
    for path in (paths[0], paths[2], paths[3]):  # one run of bm stopped, both of full
        for name in ("evaluations.csv", "metrics.csv"):
            lines = (path / name).read_text().splitlines(keepends=True)
            (path / name).write_text("".join(lines[:7]))
    task = collect(paths).tasks[0]
    assert task.horizon == 2_000_000
    bm, full = task.groups
    long, short = bm.runs[1], full.runs[0]
    assert long.interim["step"][-1] == 4_000_000
    early = long.interim["success"][long.interim["step"] <= 2_000_000]
    assert scores(task, bm, "speed")[1] <= early.max()
    assert scores(task, full, "speed")[0] <= short.interim["success"].max()


def test_a_stopped_run_is_no_mean_over_a_longer_training(tmp_path):
    paths = write_study(
        tmp_path, Truth(success={"bm": 0.5, "full": 0.5}), seeds=2, size=LIGHT
    )
    for name in ("evaluations.csv", "metrics.csv"):
        lines = (paths[0] / name).read_text().splitlines(keepends=True)
        (paths[0] / name).write_text("".join(lines[:7]))
    task = collect(paths).tasks[0]
    stopped, whole = task.groups[0].runs
    assert (stopped.lasts(task.horizon), whole.lasts(task.horizon)) == (False, True)
    only = area_under_curve(
        whole.interim["step"], whole.interim["success"], task.horizon
    )
    assert scores(task, task.groups[0], "speed") == pytest.approx([only])
    config = json.loads((paths[0] / "config.json").read_text())
    config["stop_when"] = {"success": 0.001, "evaluations": 1}
    (paths[0] / "config.json").write_text(json.dumps(config))
    tasks = collect(paths).tasks  # another rule is another task
    ended = next(run for each in tasks for run in each.runs if run.path == paths[0])
    assert ended.ended_early
    assert ended.lasts(task.horizon)
    alone = next(each for each in tasks if ended in each.runs)
    assert alone.horizon == config["total_steps"] > ended.steps_done


def test_the_inputs_page_says_which_agents_receive_the_query(monkeypatch):
    """Its controls are the content controls that receive a query as well."""
    said = SimpleNamespace(constant=False, privileged=False)
    known = {"bm": None, "asked": said, "codes": said}
    roles = {"bm": "baseline", "asked": "knowledge", "codes": "content_control"}
    groups = [
        SimpleNamespace(
            name=name, role=role, scope="query" if known[name] else "scene", runs=[name]
        )
        for name, role in roles.items()
    ]
    monkeypatch.setattr(inputs, "_privileged_uses", lambda group: [])
    verdict = inputs._kind_of_input(SimpleNamespace(groups=groups), known)
    assert (
        verdict.sentence == "The knowledge vector describes the query of the episode."
    )
    assert verdict.reasons == [
        "asked, codes: the vector describes the query of the episode. Compare with codes."
    ]


def evaluated(
    folder: Path,
    success: dict[str, list[float]],
    untrained: float,
    blind: float | None = None,
) -> TaskData:
    """Collect a task whose evaluations have just these numbers, of 100 episodes each."""

    def numbers(share: float) -> dict:
        ends = wilson(round(share * 100), 100)
        found = {"success": to_dict(ends)}
        if blind is not None:
            gap = share_difference(ends, wilson(round(blind * 100), 100))
            found["vision_gain"] = to_dict(gap)
        return found

    for agent, shares in success.items():
        for seed, share in enumerate(shares):
            path = write_run(folder / agent / str(seed), agent, seed, share, size=LIGHT)
            own = path / "evaluation" / LABEL
            other = own.with_name(f"{LABEL}-untrained")
            shutil.copytree(own, other)
            edit_summary(own, **numbers(share))
            edit_summary(other, **numbers(untrained), return_mean=-90.0)
    (task,) = collect([folder]).tasks
    return task


@pytest.mark.parametrize(
    ("success", "untrained", "blind", "said"),
    [
        (
            0.9,
            0.0,
            0.2,
            "training succeeded: bm and full succeeded clearly more often than",
        ),
        (0.01, 0.0, None, "training did not succeed"),
        (0.3, 0.0, 0.33, "training did not succeed"),
        (0.9, 0.88, None, "training did not succeed"),
    ],
)
def test_training_succeeded_only_with_clearly_more_success(
    tmp_path, success, untrained, blind, said
):
    task = evaluated(
        tmp_path, {"bm": [success] * 2, "full": [success] * 2}, untrained, blind
    )
    verdict = learning_verdict(task)
    assert said in verdict.sentence
    assert ("without vision" in verdict.sentence) == (blind is not None)


def test_success_below_that_without_vision_is_not_called_a_part_of_it(tmp_path):
    task = evaluated(tmp_path, {"bm": [0.0, 0.01], "full": [0.9, 0.95]}, 0.0, 0.3)
    verdict = vision_verdict(task)
    assert (
        "the success of full depends on vision; for bm this is not shown."
        in verdict.sentence
    )
    assert "bm: success 0.5\u202f%; the better of a fixed list" in verdict.reasons[0]
    assert "difference \u221229.5 points" in verdict.reasons[0]


def test_few_seeds_are_shown_and_differences_of_equal_ones_have_no_interval(tmp_path):
    task = evaluated(tmp_path, {"bm": [0.5] * 3, "full": [0.9] * 3}, 0.0, 0.2)
    study = StudyData((task,))
    pages = build_pages(study)
    first, table, *_ = pages[0].blocks
    words = "full: better than the baseline, but its network is larger, too."
    assert first.sentence == f"Does the knowledge help? {words}"
    assert isinstance(table, Figure)
    assert table.open_table
    hidden = [
        block for block in flat(pages[0].blocks[-1:]) if isinstance(block, Verdict)
    ]
    assert any("depends on vision" in each.sentence for each in hidden)
    claim = next(claim for claim in claims(study) if claim.outcome == "success")
    assert "full against bm: +40.0 points (no interval" in claim.sentence()
    assert "training seeds +30.0, +30.0 and +30.0" in vision_verdict(task).reasons[0]
