"""The LeRobot plugin under the real LeRobot, in an environment of its own (Python 3.12).

python3.12 -m venv lerobot
lerobot/bin/pip install 'lerobot[dataset]>=0.6' . plugins/lerobot_env_knowarm
KNOWARM_LEROBOT_ENV_PYTHON=$PWD/lerobot/bin/python pytest tests/benchmark/test_lerobot_env.py
"""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from knowarm.benchmark import freezing
from knowarm.benchmark.suites import read_suite
from knowarm.experiment.evaluation import EvaluationConfig
from knowarm.world.agents.scripted import ZeroAgent
from knowarm.world.config import EnvConfig, facets_of

CODE = '''
import json
import sys
import numpy as np
import torch
from torch import nn

from lerobot.utils.import_utils import register_third_party_plugins

register_third_party_plugins()  # as every command of LeRobot does as it starts

from lerobot.envs.factory import make_env, make_env_config
from lerobot.envs.utils import env_to_policy_features
from lerobot.processor import PolicyProcessorPipeline
from lerobot.processor.converters import policy_action_to_transition, transition_to_policy_action
from lerobot.scripts.lerobot_eval import rollout

from knowarm.benchmark.suites import read_suite
from knowarm.world.tasks.skills.ik import InverseKinematics
from knowarm.world.envs.vector_env import ArmVectorEnv

N = 4


class Oracle(nn.Module):
    """Commands the joint angles of the true grasp pose."""

    def __init__(self, targets):
        super().__init__()
        self.targets, self.seen = torch.from_numpy(targets), []

    def reset(self):
        self.seen = []

    def select_action(self, observation):
        self.seen.append(observation)
        return self.targets


def solved(cell):
    env = ArmVectorEnv(cell.env, N)
    env.reset(options={"episodes": cell.episodes[:N]})
    solver = InverseKinematics(env.scene, seed=0)
    reach = solver.solve(env.running.goal_position, env.running.goal_matrix, env.joint_positions)
    return reach.joints.astype(np.float32)


def main():
    none = PolicyProcessorPipeline(steps=[])
    action = PolicyProcessorPipeline(
        steps=[],
        to_transition=policy_action_to_transition,
        to_output=transition_to_policy_action,
    )
    found = {}
    own = sys.argv[1]
    for task in ("reach-v1/irb120-fixed", "choose-v1/tiago-S1", f"{own}/mine"):
        config = make_env_config("knowarm", task=task)
        features = {name: list(each.shape) for name, each in env_to_policy_features(config).items()}
        suite, cell = task.rsplit("/", 1)
        ((_, cells),) = make_env(config, n_envs=N).items()
        policy = Oracle(solved(read_suite(suite).cells[cell]))
        done = rollout(cells[0], policy, none, none, none, action, seeds=list(range(N)))
        first = policy.seen[0]
        found[task] = {
            "features": features,
            "success": done["success"].any(dim=1).tolist(),
            "task": first["task"],
            "image": list(first["observation.image"].shape),
            "state": list(first["observation.state"].shape),
        }
        _, infos = cells[0].reset(seed=list(range(N)))
        found[task]["infos"] = [infos["is_success"].tolist()]
        for _ in range(3):
            infos = cells[0].step(policy.targets.numpy())[-1]
            found[task]["infos"].append(infos["is_success"].tolist())
    found["asynchronous"] = []
    for task in ("choose-v1/tiago-S1", f"{own}/mine"):
        config = make_env_config("knowarm", task=task)
        found["asynchronous"] += make_env(config, n_envs=2, use_async_envs=True)
    found["errors"] = []
    for task in ("reach-v1", own, f"{own}/nobody", f"{own}-gone/mine", ""):
        try:
            make_env_config("knowarm", task=task)
        except Exception as error:
            found["errors"].append(str(error))
    print(json.dumps(found))


if __name__ == "__main__":  # LeRobot's processes import this file
    main()
'''


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    """A suite of one's own, frozen in a folder with a space: cells of two robots."""
    folder = tmp_path_factory.mktemp("suites") / "my suite"
    cells = []
    with pytest.MonkeyPatch.context() as patch:
        still = np.full((50, 1), 3)
        patch.setattr(freezing, "search_open_loop", lambda env: still)
        patch.setattr(freezing, "OpenLoopAgent", lambda listed: ZeroAgent())
        for name, robot in (("mine", "irb120"), ("other", "tiago")):
            env = EnvConfig(robot=robot, targets=("mug", "kettle"))
            how = EvaluationConfig(episodes=8)
            cells.append(freezing.freeze_cell(name, env, how, episodes=8))
    freezing.write_suite(folder, "Mugs and kettles", cells)
    return read_suite(folder.as_posix())


@pytest.fixture(scope="module")
def found(tmp_path_factory, own):
    """What a Python with LeRobot prints after it ran the plugin."""
    python = os.environ.get("KNOWARM_LEROBOT_ENV_PYTHON")
    if python is None:
        pytest.skip(
            "KNOWARM_LEROBOT_ENV_PYTHON names no Python with lerobot_env_knowarm"
        )
    script = tmp_path_factory.mktemp("lerobot") / "script.py"
    script.write_text(CODE)
    environment = os.environ | {"HF_HUB_OFFLINE": "1"}
    environment.pop("PYTHONPATH", None)
    done = subprocess.run(
        [python, str(script), own.name],
        capture_output=True,
        text=True,
        env=environment,
        timeout=600,
    )
    assert done.returncode == 0, done.stderr[-4000:]
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.parametrize(
    ("task", "joints"), [("reach-v1/irb120-fixed", 6), ("choose-v1/tiago-S1", 7)]
)
def test_a_rollout_of_lerobot_plays_the_frozen_episodes(found, task, joints):
    played = found[task]
    assert played["success"] == [True] * 4
    assert played["image"] == [4, 3, 64, 64]
    assert played["state"] == [4, joints]
    assert played["features"] == {
        "action": [joints],
        "observation.state": [joints],
        "observation.image": [3, 64, 64],
    }
    assert all(len(values) == 4 for values in played["infos"])


def test_the_query_is_the_task_description(found):
    cell = read_suite("choose-v1").cells["tiago-S1"]
    assert found["choose-v1/tiago-S1"]["task"] == cell.episodes.question[:4].tolist()
    cell = read_suite("reach-v1").cells["irb120-fixed"]
    shown = [facets_of(cell.env)[i] for i in cell.episodes.objects[:4, 0]]
    assert found["reach-v1/irb120-fixed"]["task"] == [
        f"{c} {name}" for name, c in shown
    ]


def test_a_suite_of_one_s_own_is_played_as_a_shipped_one(found, own):
    played = found[f"{own.name}/mine"]
    assert played["success"] == [True] * 4
    assert played["state"] == [4, 6]
    names = own.cells["mine"].episodes.names[:4, 0]
    assert [task.split()[-1] for task in played["task"]] == names.tolist()


def test_environments_in_processes_and_cells_of_two_robots(found, own):
    assert found["asynchronous"] == ["choose-v1", own.name]
    shipped, mine, cell, gone, nothing = found["errors"]
    fitting = "name one robot's, such as reach-v1/irb120-fixed or reach-v1/tiago-fixed."
    assert shipped.endswith(fitting)
    assert mine.endswith(f"such as {own.name}/mine or {own.name}/other.")
    assert cell == f"{own.name} has no cell 'nobody'; it has mine, other."
    for error in (gone, nothing):
        assert "Unknown suite" in error
        assert "benchmark freeze" in error
    assert not any("\n" in error for error in found["errors"])


def test_the_package_has_the_prefix_that_lerobot_looks_for():
    project = Path(__file__).parents[2] / "plugins/lerobot_env_knowarm/pyproject.toml"
    assert '\nname = "lerobot_env_' in project.read_text()
    assert project.with_name("lerobot_env_knowarm.py").is_file()
