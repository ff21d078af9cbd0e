"""Every shipped policy through every door: the same episodes give the same actions.

In `make test`, each policy goes through a third of the doors, and each door takes two policies: one
that chooses and one that does not.
"""

import copy
import pickle
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import gymnasium
import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from gymnasium.vector import AutoresetMode

import knowarm
from knowarm.benchmark.policies import entrant
from knowarm.benchmark.suites import Cell
from knowarm.deploy.record import DATA, record
from knowarm.errors import UserError
from knowarm.experiment.evaluation import SplitTest
from knowarm.experiment.zoo import POLICIES as SHIPPED
from knowarm.world.agents.protocol import Batch
from tests.source_tree import ROOT
from tests.thorough import share, thorough

ZOO = ROOT / "zoo"
SEEN = sorted(name for name in SHIPPED if name.endswith("-seen"))
"""Those that see and solve need joint angles, which an observation does not hold."""
POLICIES = sorted(SHIPPED.keys() - SEEN)
CHOOSERS = [name for name in POLICIES if "-choose-" in name]
OTHERS = [name for name in POLICIES if name not in CHOOSERS]
ASKED_SEEN = [name for name in SEEN if "-choose-" in name]
JUDGED = {"success_distance_m": 0.1, "success_angle_deg": 17.0}  # of evaluations


class Doors:
    """A policy, its environment and some episodes; each method plays them in another way.

    Methods return the actions of each episode, (T, J) each.
    """

    def __init__(self, name, count):
        self.trained = knowarm.load_agent(ZOO / name)
        self.config = replace(self.trained.config.env, **JUDGED)
        self.options = dict(vars(self.config))
        self.count = count
        self.seed = knowarm.EvaluationConfig().seed
        self.episodes = knowarm.evaluation_episodes(self.config, count, self.seed)

    @property
    def name(self):
        """Gymnasium id."""
        return knowarm.world.env_id(self.config.robot, self.config.task.name)

    def result(self, env):
        """Play by `knowarm.play`."""
        return knowarm.play(self.trained, env, self.episodes)

    def actions(self, result):
        """Return the actions of each episode of a result."""
        steps = result.steps
        return [steps.actions[steps.episode == i] for i in range(self.count)]

    def played(self, env):
        """Return the actions of `knowarm.play`."""
        return self.actions(self.result(env))

    def recorded(self, folder, num_envs=4):
        """Return the actions that a dataset of the episodes holds."""
        env = knowarm.ArmVectorEnv(self.config, num_envs)
        record(self.trained.player, env, self.episodes, folder)
        table = pq.read_table(folder / DATA.format(chunk_index=0, file_index=0))
        levels = np.array(table["action.levels"].to_pylist())
        number = table["episode_index"].to_numpy()
        return [levels[number == i] for i in range(self.count)]

    def entered(self):
        """Play as the benchmark plays a run folder in a cell of these episodes."""
        env = knowarm.ArmVectorEnv(self.config, self.count)
        cell = Cell("mine", self.config, None, self.episodes, np.zeros((1, 1)), {})
        agent = entrant(str(ZOO / self.trained.config.name)).make(cell, env)
        return self.actions(knowarm.play(agent, env, self.episodes))

    def alone(self, env, form=lambda observation: observation):
        """Play one episode after the other in a single environment."""
        actions = []
        for i in range(self.count):
            start = self.episodes[i : i + 1]
            observation, info = env.reset(options={"episodes": start})
            self.trained.reset(info)
            chosen = []
            ended = False
            while not ended:
                chosen.append(self.trained.act(form(observation)))
                observation, _, terminated, truncated, info = env.step(chosen[-1])
                ended = terminated or truncated
            actions.append(np.array(chosen))
        return actions

    def together(self, env, start, again=lambda env, ended: None):
        """Play one episode in each of n environments."""
        images, infos = env.reset(**start)
        self.trained.reset(infos)
        chosen = [[] for _ in range(env.num_envs)]
        ended = np.zeros(env.num_envs, bool)
        while not ended.all():
            actions = self.trained.act(np.asarray(images))
            for i in np.flatnonzero(~ended):
                chosen[i].append(actions[i])
            if isinstance(env, knowarm.TorchArmVectorEnv):
                actions = torch.from_numpy(actions)
            images, _, terminated, truncated, _ = env.step(actions)
            now = np.asarray(terminated | truncated)
            ended |= now
            if now.any():
                again(env, now)
        return list(map(np.array, chosen))

    def vector(self, make=knowarm.make, **options):
        """Play in an environment with n = number of episodes."""
        env = make(self.name, num_envs=self.count, **self.options_of_id, **options)
        start = {"options": {"episodes": self.episodes}}
        if options.get("autoreset_mode") == AutoresetMode.DISABLED:
            return self.together(
                env, start, lambda env, now: env.reset(options={"reset_mask": now})
            )
        return self.together(env, start)

    @property
    def options_of_id(self):
        """Fields of the config beside those that an id gives."""
        options = dict(self.options)
        for name in ("robot", "task", "max_episode_steps"):  # the id gives them
            options.pop(name)
        return options

    def single(self, make=gymnasium.make, **options):
        """Make a single environment of the id."""
        return make(self.name, **self.options_of_id, **options)


def fortran(image):
    """Return an image in another layout of the memory."""
    return np.asfortranarray(image)


SIDE_BY_SIDE = {}
for mode in AutoresetMode:
    for maker in (knowarm.make, gymnasium.make_vec):
        SIDE_BY_SIDE[f"{maker.__module__} {mode.value}"] = (maker, mode)


def copied(env):
    """Return an environment that was written and read."""
    return pickle.loads(pickle.dumps(env))


DOORS = {
    "play, vector": lambda doors: doors.played(knowarm.ArmVectorEnv(doors.config, 3)),
    "play, single": lambda doors: doors.played(doors.single()),
    "play, copy": lambda doors: doors.played(copy.deepcopy(doors.single(knowarm.make))),
    "play, pickled": lambda doors: doors.played(
        copied(knowarm.ArmVectorEnv(doors.config, 2))
    ),
    "benchmark": lambda doors: doors.entered(),
    "gymnasium.make": lambda doors: doors.alone(doors.single()),
    "knowarm.make": lambda doors: doors.alone(doors.single(knowarm.make)),
    "image and joints": lambda doors: doors.alone(
        doors.single(observe=("image", "joints"))
    ),
    "Fortran-ordered images": lambda doors: doors.alone(doors.single(), fortran),
    "tensors": lambda doors: doors.vector(device="cpu"),
    **{
        name: lambda doors, maker=maker, mode=mode: doors.vector(
            maker, autoreset_mode=mode
        )
        for name, (maker, mode) in SIDE_BY_SIDE.items()
    },
}
DOORS_OF_MANY = {name: DOORS[name] for name in ("play, vector", "benchmark", "tensors")}
"""For more episodes than environments, or many side by side; single ones play them as few."""
SHARES = 3
OF_SHARE = {}
"""Share of the doors of each policy: those of one share are of two robots where there are two."""
for number, name in enumerate(CHOOSERS):
    OF_SHARE[name] = number % SHARES
for number, name in enumerate(OTHERS):
    OF_SHARE[name] = (number - 1) % SHARES
MANY = [
    pytest.param(name, 12, marks=pytest.mark.slow(10))
    for name in thorough((CHOOSERS[0], OTHERS[1]), POLICIES)
]
# Ways to a grasp have as many points as the longest of those that are solved together.
DOORS_OF_SEEN = {
    "play, copy": lambda doors: doors.played(
        copy.deepcopy(knowarm.ArmVectorEnv(doors.config, doors.count))
    ),
    "play, pickled": lambda doors: doors.played(
        copied(knowarm.ArmVectorEnv(doors.config, doors.count))
    ),
    "benchmark": lambda doors: doors.entered(),
}
"""Each takes seconds."""


def compare(doors, others):
    """Check that `evaluate`, `play` and other doors give the same actions; return them."""
    result = doors.result(knowarm.ArmVectorEnv(doors.config, doors.count))
    evaluated = knowarm.evaluate(
        doors.trained, episodes=doors.count, probes=(), write=False
    ).episodes
    np.testing.assert_array_equal(evaluated["return"], result.episode_return)
    np.testing.assert_array_equal(evaluated["length"], result.length)
    expected = doors.actions(result)
    for door, play in others.items():
        same(play(doors), expected, door)
    return expected


def same(actions, expected, door):
    """Check that the actions of each episode are the expected ones."""
    for mine, theirs in zip(actions, expected, strict=True):
        np.testing.assert_array_equal(mine, theirs, err_msg=door)


@pytest.mark.parametrize(("name", "count"), [*[(name, 3) for name in POLICIES], *MANY])
def test_every_door_gives_the_actions_of_evaluate(name, count, tmp_path):
    doors = Doors(name, count)
    of_share = share(DOORS, OF_SHARE[name], SHARES)
    few = {door: DOORS[door] for door in of_share}
    expected = compare(doors, few if count == 3 else DOORS_OF_MANY)
    same(doors.recorded(tmp_path / "dataset"), expected, "record")


@pytest.mark.slow(20)
@pytest.mark.parametrize("count", thorough([3], [3, 12]))
@pytest.mark.parametrize("name", SEEN)
def test_what_sees_and_solves_acts_alike_where_joint_angles_are_told(
    name, count, tmp_path
):
    doors = Doors(name, count)
    expected = compare(doors, DOORS_OF_SEEN)
    same(doors.recorded(tmp_path / "dataset", count), expected, "record")
    env = doors.single()
    doors.trained.reset(env.reset(seed=0)[1])
    with pytest.raises(UserError, match=r"play it by `knowarm.play`") as error:
        doors.trained.act(env.observation_space.sample())
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("name", "mode"),
    [
        *[(name, "sync") for name in POLICIES],
        pytest.param(POLICIES[0], "async", marks=pytest.mark.slow),
    ],
)
def test_environments_of_gymnasium_side_by_side_give_the_same_actions(name, mode):
    doors = Doors(name, 3)
    seeded = {"seed": 5}
    env = knowarm.make(doors.name, num_envs=3, **doors.options_of_id)
    expected = doors.together(env, seeded)
    theirs = gymnasium.make_vec(
        doors.name, num_envs=3, vectorization_mode=mode, **doors.options_of_id
    )
    same(doors.together(theirs, seeded), expected, mode)
    theirs.close()


@pytest.mark.parametrize("name", POLICIES)
def test_environments_of_stable_baselines_give_the_same_actions(name):
    pytest.importorskip("stable_baselines3")
    doors = Doors(name, 3)
    env = knowarm.make(doors.name, num_envs=3, **doors.options_of_id)
    expected = doors.together(env, {"seed": 5})
    options = {"autoreset_mode": AutoresetMode.SAME_STEP, **doors.options_of_id}
    inner = knowarm.make(doors.name, num_envs=3, **options)
    theirs = knowarm.SB3VecEnv(inner, seed=5)
    images = theirs.reset()
    doors.trained.reset(Batch.of(inner))
    chosen = [[], [], []]
    ended = np.zeros(3, bool)
    while not ended.all():
        actions = doors.trained.act(images)
        for i in np.flatnonzero(~ended):
            chosen[i].append(actions[i])
        images, _, done, _ = theirs.step(actions)
        ended |= done
    same(list(map(np.array, chosen)), expected, "SB3VecEnv")


EXPORTED = ("tiago-place-full-distil",)
"""Beside the policy of which six episodes are played; tests/deploy/test_export.py exports more."""


@pytest.mark.parametrize(
    ("name", "count"),
    [
        *[(name, 3) for name in thorough(EXPORTED, POLICIES)],
        pytest.param(CHOOSERS[0], 6, marks=pytest.mark.slow(8)),
    ],
)
def test_exported_and_served_policies_give_the_same_actions(name, count, exported_zoo):
    for package in ("onnxruntime", "onnxscript", "websockets", "msgpack"):
        pytest.importorskip(package)
    from knowarm.benchmark.external import ExportedPolicy
    from knowarm.deploy.client import Client
    from knowarm.deploy.runner import Runner
    from knowarm.deploy.serve import PolicyServer

    doors = Doors(name, count)
    result = doors.result(knowarm.ArmVectorEnv(doors.config, count))
    expected = doors.actions(result)
    folder = exported_zoo(name)
    server = PolicyServer(lambda: Runner.load(folder), port=0)
    threading.Thread(target=server.run, daemon=True).start()

    def played(agent, num_envs):
        env = knowarm.ArmVectorEnv(doors.config, num_envs)
        return doors.actions(knowarm.play(agent, env, doors.episodes))

    def served(num_envs):
        """Return joint angles; at a limit, two levels lead to the same target.

        There is a connection per environment, of which a server takes eight.
        """
        env = knowarm.ArmVectorEnv(doors.config, num_envs)
        client = Client(f"ws://127.0.0.1:{server.port}")
        return angles(knowarm.play(client, env, doors.episodes).steps)

    def angles(steps):
        return [steps.joint_positions[steps.episode == i] for i in range(count)]

    try:
        same(played(ExportedPolicy(folder), count), expected, "exported")
        same(played(ExportedPolicy(folder), 1), expected, "exported, one by one")
        expected = angles(result.steps)
        same(served(4), expected, "served")
        with ThreadPoolExecutor(3) as clients:
            for actions in clients.map(served, [1, 1, 2]):
                same(actions, expected, "served to three clients at once")
    finally:
        server.close()


LEAST_RIGHT = {
    "own": 0.8,
    "reversed": 0.8,
    "fewer": 0.6,  # what is new to an agent is logged
    "two side by side": 0.85,
    "five side by side": 0.75,
}


@pytest.mark.parametrize("name", CHOOSERS)
def test_an_environment_may_show_its_objects_in_another_order_fewer_and_more(name):
    doors = Doors(name, 40)
    config = doors.config
    shown = {facet for facet, _ in doors.trained.network.spec.facets}
    known = [target for target in config.targets if target in shown]
    some = known[::2]
    cases = {
        "own": {},
        "reversed": {"targets": tuple(reversed(config.targets))},
        "fewer": {"targets": tuple(some)},
        "two side by side": {"task": replace(config.task.asked, objects=2)},
        "five side by side": {"task": replace(config.task.asked, objects=5)},
    }
    for case in share(cases, CHOOSERS.index(name), len(CHOOSERS)):
        env = knowarm.ArmVectorEnv(replace(config, **cases[case]), 40)
        images, infos = env.reset(seed=3)
        doors.trained.reset(infos)
        goal = np.zeros(40, bool)
        ended = np.zeros(40, bool)
        while not ended.all():
            images, _, terminated, truncated, infos = env.step(
                doors.trained.act(images)
            )
            now = (terminated | truncated) & ~ended
            if now.any():
                goal[now] = infos["final_info"]["is_right_object"][now]
            ended |= now
        assert goal.mean() > LEAST_RIGHT[case], case


@pytest.mark.parametrize(
    ("name", "count"),
    [
        *[(name, 3) for name in thorough((), CHOOSERS)],
        pytest.param(CHOOSERS[0], 12, marks=pytest.mark.slow(8)),
        *[pytest.param(name, 3, marks=pytest.mark.slow(8)) for name in ASKED_SEEN],
    ],
)
def test_an_environment_of_an_edited_graph_is_played_as_evaluate_does(name, count):
    doors = Doors(name, count)
    task = doors.config.task.asking(split="S5")
    env = knowarm.ArmVectorEnv(replace(doors.config, task=task), count)
    edited = task.asked.edited_graph(env.facets)
    evaluated = knowarm.evaluate(
        doors.trained,
        episodes=count,
        test=(SplitTest(split="S5"),),
        probes=(),
        write=False,
    )
    episodes = knowarm.evaluation_episodes(env.config, count, doors.seed)
    other = knowarm.load_agent(ZOO / name, graph=edited)
    result = knowarm.play(other, env, episodes)
    for column, values in {
        "return": result.episode_return,
        "length": result.length,
        "distance_m": result.distance,
    }.items():
        np.testing.assert_array_equal(evaluated.episodes[column], values)
    by_own = knowarm.play(doors.trained, env, episodes)
    assert not np.array_equal(by_own.episode_return, result.episode_return)
