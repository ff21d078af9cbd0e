"""The benchmark of vla-eval, by vla-eval's own contract: `pip install vla-eval` to run it."""

import asyncio
import sys

import numpy as np
import pytest

from knowarm.benchmark.suites import read_suite
from knowarm.errors import UserError
from knowarm.world.agents.play import play
from knowarm.world.agents.scripted import OracleAgent
from knowarm.world.envs.vector_env import ArmVectorEnv
from tests.source_tree import ROOT

pytest.importorskip("vla_eval")
sys.path.append(str(ROOT / "plugins" / "vla_eval_knowarm"))

from vla_eval.benchmarks.base import StepBenchmark
from vla_eval_knowarm import KnowArmBenchmark

CELL = read_suite("reach-v1").cells["irb120-fixed"]


async def episode(benchmark, task, targets):
    """Play an episode through the methods that a runner calls."""
    await benchmark.start_episode(task)
    seen = [await benchmark.get_observation()]
    while not await benchmark.is_done():
        await benchmark.apply_action({"actions": targets[len(seen) - 1]})
        seen.append(await benchmark.get_observation())
    return seen, await benchmark.get_result()


def test_an_episode_is_played_as_by_knowarm():
    benchmark = KnowArmBenchmark("reach-v1/irb120")
    assert isinstance(benchmark, StepBenchmark)
    tasks = benchmark.get_tasks()
    assert [task["name"] for task in tasks] == ["irb120-fixed", "irb120-randomized"]
    env = ArmVectorEnv(CELL.env, 3)
    result = play(OracleAgent(env), env, CELL.episodes[:3], record_images=3)
    levels = env.running.increments[result.steps.actions]
    for i in range(3):
        rows = result.steps.episode == i
        env.reset(options={"episodes": CELL.episodes[[i, i, i]]})
        targets = env.joint_targets[0] + levels[rows].cumsum(0)
        task = {**tasks[0], "episode_idx": i}
        seen, outcome = asyncio.run(episode(benchmark, task, targets))
        assert outcome == {"success": bool(result.success[i])}
        images = np.stack([each["images"]["policy"] for each in seen])
        np.testing.assert_array_equal(images, result.images[i])
        name = CELL.episodes.names[i, 0]
        assert seen[0]["task_description"].endswith(f" {name}")
        state = benchmark.get_observation_spec()["state"]
        assert seen[0]["state"].shape == (6,)
        assert not state.validate(seen[0]["state"])
    action = benchmark.get_action_spec()["joints"]
    assert not action.validate(benchmark.get_hold_action(None)["actions"])
    assert benchmark.get_metadata() == {"max_steps": 50, "max_episodes_per_task": 500}
    assert benchmark.configure_render("cpu") == {}


def test_wrong_actions_and_suites_are_refused_in_one_line():
    with pytest.raises(
        UserError,
        match="different joints; name one robot's, such as reach-v1/irb120-fixed or reach-v1/tiago",
    ):
        KnowArmBenchmark("reach-v1")
    with pytest.raises(UserError, match="has no cell 'nobody'"):
        KnowArmBenchmark("reach-v1/nobody")
    benchmark = KnowArmBenchmark()
    benchmark.reset(benchmark.get_tasks()[0])
    for wrong in (np.zeros(5), np.full(6, np.nan), np.zeros((1, 6))):
        with pytest.raises(UserError, match="must be 6 finite numbers"):
            benchmark.step({"actions": wrong})
