from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from knowarm.config import from_dict, to_dict
from knowarm.errors import UserError
from knowarm.experiment.evaluate import evaluate
from knowarm.experiment.evaluation import (
    DamageTest,
    EvaluationConfig,
    GraphTest,
    HeldOutTest,
    ReasoningTest,
    SplitTest,
)
from knowarm.experiment.load import load_agent
from knowarm.experiment.minimal_pairs import other_questions
from knowarm.experiment.probes import BlindProbe, FilmsProbe, StepsProbe
from knowarm.experiment.summary import read_film, read_table, summarize
from knowarm.policy import PolicyAgent
from knowarm.statistics import wilson
from knowarm.world.agents import (
    BLIND_AGENTS,
    BlindAgent,
    BlindEntry,
    OpenLoopAgent,
    RandomAgent,
    ZeroAgent,
)
from knowarm.world.agents.open_loop import search_open_loop
from knowarm.world.config import EnvConfig, questions_of
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.held_out import HeldOut

ZOO = Path(__file__).parents[2] / "zoo" / "tiago-full-fast"
ENV = EnvConfig(image_size=32, max_episode_steps=12, dynamics="kinematic")
SMALL = EvaluationConfig(
    episodes=24,
    probes=(StepsProbe(), FilmsProbe(episodes=2)),
    distance_m=0.4,
    angle_deg=80.0,
)
SMALL_WIDE = replace(SMALL, probes=(), angle_deg=40)


@pytest.fixture(scope="module")
def result():
    return evaluate(RandomAgent(1), ENV, SMALL, agent_name="random")


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("episodes", 0),
        ("seeds", 0),
        ("distance_m", 0.0),
        ("angle_deg", -1.0),
        ("seeds", 7),
    ],
)
def test_settings_that_cannot_be_are_refused(field, value):
    with pytest.raises(UserError, match=field.rstrip("s")):
        EvaluationConfig(**{field: value})


def test_it_plays_by_its_own_thresholds(result):
    episodes = result.episodes
    assert result.summary.env["success_distance_m"] == 0.4
    assert result.summary["episodes"] == len(episodes["episode"]) == 24
    assert (episodes["distance_m"][episodes["success"]] < 0.4).all()
    assert (episodes["angle_deg"][episodes["success"]] < 80).all()
    assert (episodes["length"][~episodes["success"]] == 12).all()
    assert 0 < result.summary["success"] < 1


def test_steps_belong_to_their_episodes(result):
    steps, episodes = result.steps, result.episodes
    np.testing.assert_array_equal(np.bincount(steps["episode"]), episodes["length"])
    last = np.cumsum(episodes["length"]) - 1
    np.testing.assert_allclose(steps["distance_m"][last], episodes["distance_m"])
    sums = np.bincount(steps["episode"], steps["reward"])
    np.testing.assert_allclose(sums, episodes["return"])
    assert {"joint_6_rad", "action_6"} <= set(steps)


def test_the_same_evaluation_gives_the_same_bytes(result, tmp_path):
    again = evaluate(RandomAgent(1), ENV, SMALL, agent_name="random")
    result.write(tmp_path / "a")
    again.write(tmp_path / "b")
    names = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*.*"))
    assert [str(name) for name in names] == [
        "episodes.parquet",
        "films/0.webp",
        "films/1.webp",
        "steps.parquet",
        "summary.json",
    ]
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (
            tmp_path / "b" / name
        ).read_bytes()


def test_what_was_written_is_what_was_found(result, tmp_path):
    result.write(tmp_path)
    read = read_table(tmp_path / "episodes.parquet")
    assert list(read) == list(result.episodes)
    for name, values in result.episodes.items():
        np.testing.assert_array_equal(read[name], values)
    frames = read_film(tmp_path / "films" / "0.webp")
    np.testing.assert_array_equal(frames, result.films[0])
    assert len(frames) == result.episodes["length"][0] + 1


def test_agents_play_the_same_episodes_at_any_batch_size(monkeypatch):
    one = evaluate(ZeroAgent(), ENV, SMALL)
    monkeypatch.setattr("knowarm.experiment.evaluate.BATCH", 10)
    other = evaluate(ZeroAgent(), ENV, SMALL)
    for name in ("facet", "distance_m", "angle_deg", "return"):
        np.testing.assert_array_equal(one.episodes[name], other.episodes[name])


def test_the_wider_angle_is_judged_as_if_it_had_been_played(monkeypatch):
    monkeypatch.setattr("knowarm.experiment.evaluate.WIDE_ANGLE_DEG", 180.0)
    narrow = evaluate(ZeroAgent(), ENV, SMALL_WIDE)
    played = evaluate(ZeroAgent(), ENV, replace(SMALL_WIDE, angle_deg=180.0))
    assert narrow.summary["success"] < narrow.summary["success_wide"]
    np.testing.assert_array_equal(
        narrow.episodes["success_wide"], played.episodes["success"]
    )


def test_evaluation_seeds_share_the_episodes():
    config = EvaluationConfig(episodes=12, seeds=3, seed=5, probes=())
    whole = evaluate(ZeroAgent(), ENV, config)
    np.testing.assert_array_equal(
        whole.episodes["evaluation_seed"], np.repeat([5, 6, 7], 4)
    )
    second = evaluate(ZeroAgent(), ENV, EvaluationConfig(episodes=4, seed=6, probes=()))
    np.testing.assert_array_equal(
        whole.episodes["distance_m"][4:8], second.episodes["distance_m"]
    )


def test_an_unwritable_place_is_named(result, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="Cannot write"):
        result.write(tmp_path / "file" / "evaluation")


def test_held_out_colours_are_played_when_asked_for():
    held_out = HeldOut(colours=("blue", "purple"))
    env = replace(ENV, colours="randomized", held_out=held_out)
    config = EvaluationConfig(episodes=30, probes=())
    seen = evaluate(ZeroAgent(), env, config).episodes["facet"]
    asked = replace(config, test=(HeldOutTest(),))
    unseen = evaluate(ZeroAgent(), env, asked)
    assert not {"mug/blue", "bottle/purple"} & set(seen)
    assert {"mug/blue", "bottle/purple"} < set(unseen.episodes["facet"])
    assert "mug/red" not in unseen.episodes["facet"]
    assert unseen.summary.label == "post-training-greedy-held-out"
    with pytest.raises(UserError, match="holds none out"):
        evaluate(ZeroAgent(), ENV, asked)


def played(success=(True, True, False, False), distance=(0.05, 0.08, 0.09, 0.5)):
    count = len(success)
    return {
        "target": np.array(["mug", "mug", "bottle", "bottle"][:count]),
        "facet": np.array(
            ["mug/red", "mug/blue", "bottle/yellow", "bottle/yellow"][:count]
        ),
        "return": np.array([90.0, 80.0, -10.0, -40.0][:count]),
        "length": np.array([5, 9, 50, 50][:count]),
        "distance_m": np.array(distance),
        "angle_deg": np.array([3.0, 5.0, 40.0, 80.0][:count]),
        "success": np.array(success),
        "accurate": np.array(distance) <= 0.1,
        "success_wide": np.array(success),
    }


def test_the_paper_s_numbers_by_hand():
    numbers, groups = summarize(played())
    found = {
        name: getattr(number, "estimate", number) for name, number in numbers.items()
    }
    assert found["return_mean"] == 30
    assert found["return_std"] == pytest.approx(np.std([90, 80, -10, -40], ddof=1))
    assert found["length_mean"] == 28.5
    assert found["accuracy"] == 0.75  # the third ends near, at a wrong angle
    assert found["success"] == 0.5
    assert found["failure_distance_mean"] == pytest.approx(0.295)
    assert found["failure_distance_std"] == pytest.approx(np.std([0.09, 0.5], ddof=1))
    assert found["failure_distance_max"] == 0.5
    assert numbers["accuracy"] == wilson(3, 4)
    assert (
        numbers["return_mean"].low < found["return_mean"] < numbers["return_mean"].high
    )
    targets, facets = (groups[name] for name in ("target", "facet"))
    assert set(targets) == {"mug", "bottle"}
    assert set(facets) == {"mug/red", "mug/blue", "bottle/yellow"}
    assert sum(part["episodes"] for part in facets.values()) == found["episodes"]
    assert targets["mug"]["success"].estimate == 1


def test_without_failures_there_is_no_failure_distance():
    found, _ = summarize(played((True,), (0.01,)))
    assert not {"failure_distance_mean", "failure_distance_max"} & set(found)
    assert found["return_std"] == 0


def test_blind_agents_stand_beside_a_trained_one(monkeypatch):
    quick = BlindEntry(
        make=lambda agent, env, seed: OpenLoopAgent(
            search_open_loop(env.config, 200, seed)
        ),
        about="",
    )
    monkeypatch.setitem(BLIND_AGENTS, "open-loop", quick)
    trained = load_agent(ZOO)
    config = EvaluationConfig(episodes=40, probes=(BlindProbe(episodes=20),))
    summary = evaluate(trained, config=config, write=False).summary
    blind = summary.groups["blind"]
    assert list(blind) == list(BLIND_AGENTS)
    for found in blind.values():
        assert found["episodes"] == 20
        difference = found["difference"]
        assert difference.estimate == pytest.approx(
            summary["success"] - found["success"].estimate
        )
        assert difference.low < difference.estimate <= difference.high
    best = max(blind[name]["success"].estimate for name in ("open-loop", "blind"))
    assert summary["vision_gain"] == pytest.approx(summary["success"] - best)
    alone = evaluate(
        BlindAgent(trained.agent),
        trained.config.env,
        replace(config, episodes=20),
        seed=config.seed,
    )
    assert alone.summary["success"] == blind["blind"]["success"].estimate
    without = evaluate(trained, config=replace(config, probes=()), write=False).summary
    seen = {
        name: each for name, each in summary.numbers.items() if name != "vision_gain"
    }
    assert without.numbers == seen
    assert without.groups == {n: g for n, g in summary.groups.items() if n != "blind"}


def test_untrained_and_scripted_agents_are_evaluated_alone():
    config = EvaluationConfig(episodes=4)
    untrained = evaluate(load_agent(ZOO, which="untrained"), config=config, write=False)
    scripted = evaluate(ZeroAgent(), ENV, config)
    assert "blind" not in untrained.summary.groups
    assert "blind" not in scripted.summary.groups


BRIEF = EvaluationConfig(episodes=4, probes=())


def test_a_loaded_agent_acts_as_it_was_loaded_and_twice_the_same():
    with pytest.raises(UserError, match=r"greedy=True, and actions is 'sampled'"):
        evaluate(load_agent(ZOO), config=BRIEF, actions="sampled", write=False)
    sampled = load_agent(ZOO, greedy=False)
    results = [
        evaluate(agent, config=BRIEF, actions="sampled", write=False).episodes["return"]
        for agent in (sampled, sampled, ZOO)
    ]
    assert (results[0] == results[1]).all()
    assert (results[0] == results[2]).all()


@pytest.mark.parametrize(
    ("condition", "name"),
    [
        (GraphTest(graph="objects"), "graph"),
        (ReasoningTest(by="graph"), "reasoning"),
        (ReasoningTest(unclear="stop"), "reasoning"),
        (DamageTest(damage="missing"), "damage"),
    ],
)
def test_conditions_of_trained_agents_are_refused_for_others(condition, name):
    with pytest.raises(UserError, match=f"Only trained agents.*{name}"):
        evaluate(ZeroAgent(), ENV, BRIEF, test=(condition,))
    with pytest.raises(UserError, match="unclear='stop'"):  # of an agent with a vector
        evaluate(ZOO, config=BRIEF, test=(ReasoningTest(unclear="stop"),), write=False)
    with pytest.raises(UserError, match=r"Only trained agents.*actions"):
        evaluate(ZeroAgent(), ENV, BRIEF, actions="sampled")


def test_another_task_does_not_replace_the_evaluation_of_the_own():
    env = replace(load_agent(ZOO).config.env, image_size=32)
    for agent in (ZOO, load_agent(ZOO, which="untrained")):
        with pytest.raises(UserError, match="label"):
            evaluate(agent, env, BRIEF)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"robot": "irb120"}, r"\(7, 64\) \| \(6, 64\)"),
        ({"image_size": 32}, r"\(7, 64\) \| \(7, 32\)"),
        ({"colours": "randomized"}, "knowledge of"),
        ({"targets": ("mug", "lamp", "bottle")}, "knowledge of .*lamp"),
    ],
)
def test_an_environment_that_an_agent_does_not_fit_is_refused(changes, words):
    trained = load_agent(ZOO)
    with pytest.raises(UserError, match=words):
        evaluate(trained, replace(trained.config.env, **changes), BRIEF, write=False)


def test_evaluations_that_differ_have_folders_of_their_own():
    missing = DamageTest(damage="missing")
    tests = {
        "missing-30": [missing],
        "missing-30-3": [replace(missing, seed=3)],
        "missing-30-complex": [replace(missing, repair="complex")],
        "s5": [SplitTest(split="S5")],
        "s5-new": [SplitTest(split="S5", edited="a/new.ttl")],
        "held-out": [HeldOutTest()],
        "s1-graph-missing-30": [
            SplitTest(split="S1"),
            ReasoningTest(by="graph"),
            missing,
        ],
        "other-graph-stop": [
            GraphTest(graph="a/other.tsv"),
            ReasoningTest(by="graph", unclear="stop"),
        ],
    }
    for label, test in tests.items():
        config = EvaluationConfig(test=tuple(test))
        assert config.folder == f"post-training-greedy-{label}"
        assert from_dict(EvaluationConfig, to_dict(config)) == config
    with pytest.raises(UserError, match=r"damage\.seed must lie between 0"):
        DamageTest(seed=-1)


def test_files_of_an_earlier_evaluation_do_not_stay(result, tmp_path):
    result.write(tmp_path)
    assert (tmp_path / "steps.parquet").exists()
    assert list((tmp_path / "films").iterdir())
    replace(result, steps=None, films=()).write(tmp_path)
    assert not (tmp_path / "steps.parquet").exists()
    assert not (tmp_path / "films").exists()


def test_binding_tells_whether_an_agent_follows_its_question(monkeypatch):
    still = BlindEntry(make=lambda agent, env, seed: ZeroAgent(), about="")
    monkeypatch.setattr("knowarm.world.agents.BLIND_AGENTS", {"zero": still})
    trained = load_agent(ZOO.parent / "irb120-choose-answers-fast")
    config = EvaluationConfig(episodes=24, probes=(BlindProbe(episodes=24),))
    found = evaluate(trained, config=config, write=False).summary.interval("binding")
    assert 0.7 < found.low <= found.estimate <= found.high <= 1
    reset = PolicyAgent.reset

    def deaf(agent, batch):
        reset(agent, replace(batch, own_rows=batch.rows[[0] * batch.size]))

    monkeypatch.setattr(PolicyAgent, "reset", deaf)
    ignoring = evaluate(trained, config=config, write=False).summary
    assert abs(ignoring["binding"]) < 0.35
    assert (
        "binding"
        not in evaluate(ZOO, config=replace(config, episodes=2), write=False).summary
    )


def test_coverage_and_questions_are_counted_at_a_level():
    run = ZOO.parent / "irb120-choose-answers-fast"
    config = EvaluationConfig(episodes=40, probes=())
    found = {
        level: evaluate(
            run,
            config=config,
            test=(ReasoningTest(unclear="ask", level=level),),
            write=False,
        )
        for level in (0.5, 0.99)
    }
    few, most = found.values()
    assert few.summary["coverage"] < most.summary["coverage"]
    assert most.summary["coverage"] > 0.9
    asked = few.episodes["visible_answers"] != 1
    assert few.summary["questions"] == asked.mean()
    assert (
        few.episodes["length"][asked] == few.episodes["length"].max()
    ).all()  # it stays
    assert few.summary.label.endswith("-ask-level-50")
    assert (
        "coverage" not in evaluate(run, config=config, episodes=2, write=False).summary
    )


def test_the_other_question_is_of_another_visible_object():
    config = load_agent(ZOO.parent / "irb120-choose-answers-fast").config.env
    env = ArmVectorEnv(config, 1)
    episodes = evaluation_episodes(config, 50, 3)
    table, scene = questions_of(config), env.scene
    rows = {query.name: row for row, query in enumerate(table.queries)}
    questions, answering = other_questions(env, episodes, 0)
    for number, question in enumerate(questions):
        shown = zip(episodes.objects[number], episodes.colours[number], strict=True)
        facets = [(scene.targets[o].name, scene.colour_names[o][c]) for o, c in shown]
        answers = [
            table.satisfies[rows[question], table.facets.index(each)] for each in facets
        ]
        assert sum(answers) == 1
        assert not answers[0]
        assert answers[answering[number]]
