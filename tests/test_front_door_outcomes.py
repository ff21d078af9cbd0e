"""Outcomes through the public door: a policy does in every environment what `evaluate` says."""

import json
import subprocess
import sys

import gymnasium
import numpy as np
import pytest

import knowarm
from knowarm.config import to_dict
from knowarm.statistics import share_difference, wilson
from tests.source_tree import ROOT
from tests.thorough import thorough

ZOO = ROOT / "zoo"
POLICIES = sorted(
    path.name
    for path in ZOO.iterdir()
    # Those that see and solve need joint angles, which environments do not show.
    if path.is_dir() and not path.name.endswith("-seen")
)
CHOOSERS = [name for name in POLICIES if "-choose-" in name]
CHOOSER = "irb120-choose-answers-fast"
PLAYED = (
    "irb120-choose-subgraph-fast",
    "irb120-full-fast",
    "tiago-choose-answers-fast",
    "tiago-place-full-distil",
)
"""Of each agent, robot and task one."""
PLACER = PLAYED[-1]
EVALUATED = thorough(50, 100)
"""Episodes that `evaluate` plays."""
TRAINING = {"distance_m": 0.05, "angle_deg": 15.0}  # the thresholds of environments


def made(agent, count=None, **options):
    """Make the environments of an agent's robot and task, as the public door has them."""
    config = agent.config.env
    return knowarm.make(config.robot, num_envs=count, task=config.task, **options)


def ends(agent, env, seed, ask=lambda env, infos: infos):
    """Play one episode in each of n environments; return the infos at their ends."""
    images, infos = env.reset(seed=seed)
    agent.reset(ask(env, infos))
    found = [None] * env.num_envs
    while None in found:
        images, _, _, _, infos = env.step(agent.act(images))
        for i in np.flatnonzero(infos.get("_final_info", np.zeros(env.num_envs))):
            last = {name: values[i] for name, values in infos["final_info"].items()}
            found[i] = found[i] or last
    return found


@pytest.mark.parametrize("name", thorough(PLAYED, POLICIES))
def test_a_policy_reaches_its_targets_and_succeeds_in_each_environment_as_often(name):
    agent = knowarm.load_agent(ZOO / name)
    summary = knowarm.evaluate(
        agent, episodes=EVALUATED, probes=(), write=False, **TRAINING
    ).summary
    env = gymnasium.make(
        knowarm.world.env_id(agent.config.env.robot, agent.config.env.task.name)
    )
    alone = []
    for seed in range(24):
        image, info = env.reset(seed=seed)
        agent.reset(info)
        ended = False
        while not ended:
            image, _, terminated, truncated, info = env.step(agent.act(image))
            ended = terminated or truncated
        alone.append(info["is_success"])
    found = ends(agent, made(agent, 40), seed=0)
    if name in CHOOSERS:
        assert summary["choice"] >= 0.9
        assert summary["success"] >= 0.75
        assert np.mean([end["is_right_object"] for end in found]) > 0.8
    else:
        lowest = 0.7 if name == PLACER else 0.8  # Of any object
        assert summary["success"] >= lowest + 0.1
        targets = summary.groups["target"].values()
        assert min(target["success"].estimate for target in targets) >= lowest
    measured = wilson(round(summary["success"] * EVALUATED), EVALUATED)
    for successes in (alone, [bool(end["is_success"]) for end in found]):
        played = wilson(int(sum(successes)), len(successes))
        difference = share_difference(played, measured)  # its 95 % interval
        assert difference.low <= 0 <= difference.high, (played, measured)


def other_questions(env, infos):
    """Ask each environment for its second object: by a query that no other visible one answers."""
    table = env.config.task.asked.questions(env.facets)
    targets, names = (
        [each.name for each in env.scene.targets],
        [name for name, _ in env.facets],
    )
    first = np.array([names.index(name) for name in targets])
    # (Q, n, m)
    answers = table.satisfies[:, first[infos["objects"]] + infos["object_colours"]]
    only = answers[..., 1] & (answers.sum(2) == 1)
    assert only.any(0).all()
    return {"query": [table.queries[row].name for row in only.argmax(0)]}


def test_another_question_leads_to_another_object():
    agent = knowarm.load_agent(ZOO / CHOOSER)
    found = ends(agent, made(agent, 40), seed=0, ask=other_questions)
    assert np.mean([end["reached_object"] == end["objects"][1] for end in found]) > 0.8
    assert np.mean([end["is_right_object"] for end in found]) < 0.1


def test_a_question_that_an_agent_does_not_know_is_refused_in_one_line():
    agent = knowarm.load_agent(ZOO / CHOOSER)
    for task in (knowarm.AskObject(queries=knowarm.NameQueries()), "purpose"):
        _, infos = knowarm.make("irb120", num_envs=2, task=task).reset(seed=0)
        with pytest.raises(
            knowarm.UserError, match=f"Unknown query.*{CHOOSER}"
        ) as error:
            agent.reset(infos)
        assert "\n" not in str(error.value)
        assert infos["query"][0] in str(error.value)


def test_episodes_of_other_questions_are_refused():
    env = made(knowarm.load_agent(ZOO / CHOOSER), 2, image_size=8)
    named = knowarm.EnvConfig(task=knowarm.AskObject(queries=knowarm.NameQueries()))
    with pytest.raises(
        knowarm.UserError, match="Unknown query of this environment 'isA"
    ):
        env.reset(options={"episodes": knowarm.evaluation_episodes(named, 2, seed=0)})


def test_a_config_with_questions_of_a_graph_is_read_without_another_import():
    text = json.dumps(to_dict(knowarm.EnvConfig(task=knowarm.AskPart())))
    code = (
        "import json, sys\nfrom knowarm.config import from_dict\n"
        "from knowarm.world.config import EnvConfig\n"
        f"print(from_dict(EnvConfig, json.loads({text!r})).task.asked.queries.graph)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert done.stdout == "purposes\n"
