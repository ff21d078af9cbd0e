"""The same input in another form, at every public door: the same result, or one line for the user.

Forms are permutations of joints, tables, objects, questions, channels and axes, and other types.
``make torture`` tries other seeds.
"""

import json
import shutil
import sys
import threading
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from types import ModuleType, SimpleNamespace
from unittest import mock

import gymnasium
import numpy as np
import pytest

import knowarm
from knowarm.asking.asker import Asker
from knowarm.benchmark import rows
from knowarm.benchmark.policies import entrant
from knowarm.benchmark.suites import read_suite
from knowarm.deploy.contract import deployment, export
from knowarm.deploy.driver import Driver, Safety, decoded
from knowarm.deploy.runner import Runner, Start
from knowarm.knowledge.formats import shipped_graph
from knowarm.knowledge.graph.builder import graph_of
from knowarm.world.agents.protocol import Batch
from knowarm.world.envs.vector_env import ArmVectorEnv
from tests.source_tree import ROOT

pytest.importorskip("onnxruntime")
pytest.importorskip("onnxscript")
pytest.importorskip("websockets")

from knowarm.deploy.client import Client
from knowarm.deploy.serve import Episode, PolicyServer

Forms = Mapping[str, Callable[[], object]]
Random = np.random.Generator
CELL = read_suite("choose-v1").cells["irb120-S1"]
ROWS = ROOT / "docs" / "results" / "benchmark" / "rows"


def compare(expected: object, same: Forms, other: Forms) -> list[str]:
    """Return what is wrong: ``same`` must give the result, ``other`` may be refused in one line."""
    failures, is_array = [], isinstance(expected, np.ndarray)
    for name, call in {**same, **other}.items():
        try:
            found = call()
            if not (np.array_equal(found, expected) if is_array else found == expected):
                failures.append(f"{name}: another result")
        except ValueError as error:  # `UserError` is one
            if name in same or "\n" in str(error):
                failures.append(f"{name}: {error}")
        except Exception as error:
            failures.append(f"{name}: {type(error).__name__}: {error}")
    return failures


def forms(values: Mapping[str, object], call: Callable) -> Forms:
    return {name: lambda value=value: call(value) for name, value in values.items()}


def image_forms(image: np.ndarray, call: Callable) -> tuple[Forms, Forms]:
    """Return forms of an image (..., H, W, 3) uint8, as `compare` takes them."""
    read_only = image.copy()
    read_only.flags.writeable = False
    same = {"read-only": read_only, "another layout": np.asfortranarray(image)}
    same["view of a BGR image"] = image[..., ::-1].copy()[..., ::-1]
    other = {
        "channels first": np.moveaxis(image, -1, -3),
        "0 to 1": image / 255,
        "float32": image.astype(np.float32),
        "int64": image.astype(np.int64),
        "grey": image[..., :1],
        "RGBA": np.concatenate([image, image[..., :1]], -1),
        "half size": image[..., ::2, ::2, :],
        "double size": image.repeat(2, -2).repeat(2, -3),
        "no channels": image[..., 0],
        "two images": np.stack([image, image]),
    }
    return forms(same, call), forms(other, call)


def picture(random: Random, *count: int) -> np.ndarray:
    return random.integers(0, 256, (*count, 64, 64, 3), np.uint8)


def shuffled(values: Mapping, random: Random) -> dict:
    names = list(values)
    return {names[i]: values[names[i]] for i in random.permutation(len(names))}


def reordered(runner: Runner, random: Random) -> Runner:
    """Return a runner with the same policy, and other orders of joints and of rows."""
    about, joints = runner.contract, runner.contract["joints"]
    order, lines = (
        random.permutation(len(each)) for each in (joints["names"], runner._table)
    )

    def policy(inputs):
        levels, *rest = runner._policy(inputs)
        return [levels[:, order], *rest]

    moved = {
        name: [joints[name][i] for i in order]
        for name in ("names", "lower", "upper", "home")
    }
    named = about["knowledge"] | {
        "rows": [about["knowledge"]["rows"][i] for i in lines]
    }
    contract = about | {"joints": joints | moved, "knowledge": named}
    return Runner(contract, runner._table[lines], policy, runner._recognition)


def home(runner: Runner) -> dict[str, float]:
    joints = runner.contract["joints"]
    return dict(zip(joints["names"], joints["home"], strict=True))


def by_name(runner: Runner, targets: np.ndarray) -> list[tuple[str, float]]:
    return sorted(zip(runner.joint_names, targets.tolist(), strict=True))


class Doors:
    """A trained agent of the choose task, and what is made of it once."""

    def __init__(self, trained: knowarm.TrainedAgent, folder: Path) -> None:
        self.trained, self.folder, self.parts = trained, folder, deployment(trained)
        self.rows = self.parts.contract["knowledge"]["rows"]

    @cached_property
    def exported(self) -> Path:
        export(self.trained, self.folder / "exported")
        return self.folder / "exported"


def gymnasium_ids(doors: Doors, random: Random) -> list[str]:
    """`gymnasium.make` and `make_vec`: actions of other types, one environment of several."""
    seed, levels = int(random.integers(1000)), random.integers(0, 7, 6)
    name = str(random.choice(["knowarm/IRB120Choose-v0", "knowarm/IRB120Reach-v0"]))
    options = shuffled({"image_size": 8, "dynamics": "kinematic"}, random)
    env = gymnasium.make(name, **options).unwrapped

    def play(action):
        image, info = env.reset(seed=seed)
        return [image.sum(), *env.step(action)[0].ravel(), info["distance"]]

    def beside():
        several = gymnasium.make_vec(name, num_envs=2, **options)
        images, infos = several.reset(seed=[seed + 1, seed])
        after = several.step(np.stack([levels[::-1], levels]))[0]
        return [images[1].sum(), *after[1].ravel(), infos["distance"][1]]

    same = forms({"list": levels.tolist(), "int8": levels.astype(np.int8)}, play)
    wrong = (
        levels.astype(float),
        levels[:, None],
        levels[:5],
        levels > 2,
        levels[None],
    )
    other = forms({f"{each.dtype} {each.shape}": each for each in wrong}, play)
    return compare(play(levels), {**same, "beside another": beside}, other)


def make(doors: Doors, random: Random) -> list[str]:
    """`knowarm.make`: order of options, observations, objects, tables and triples."""
    seed, table = int(random.integers(1000)), random.random((3, 4))
    targets, options = (
        ("mug", "bottle", "cereal_box"),
        {"image_size": 8, "dynamics": "kinematic"},
    )
    drawn = knowarm.evaluation_episodes(knowarm.EnvConfig(**options), 2, seed)
    triples, graph = list(shipped_graph("objects")), doors.folder / "objects.tsv"

    def see(
        table=table, observe=("image", "knowledge", "joints"), targets=targets, **reset
    ):
        shown = {"observe": observe, "knowledge": table, "targets": targets}
        env = knowarm.make("irb120", 2, **shuffled(options | shown, random))
        seen, infos = env.reset(seed=seed, options=reset)
        names = ("image", "knowledge", "joints")
        return np.concatenate(
            [*(seen[each].ravel() for each in names), infos["distance"]]
        )

    def asked(order):
        graph.write_text("".join("\t".join(triples[i]) + "\n" for i in order), "utf-8")
        task = knowarm.AskObject(queries=knowarm.GraphQueries(graph=str(graph)))
        seen, infos = knowarm.make("irb120", 2, task=task, image_size=8).reset(
            seed=seed
        )
        return [*seen.ravel(), *infos["query"], *infos["distance"]]

    def tensors():
        return knowarm.make("irb120", 2, "cpu", **options).reset(seed=seed)[0].numpy()

    same = forms({"layout": np.asfortranarray(table), "list": table.tolist()}, see)
    same = {**same, "observe": lambda: see(observe=("joints", "image", "knowledge"))}
    failures = compare(see(), same, {"table on its side": lambda: see(table.T)})
    permuted = tuple(random.permutation(targets).tolist())
    other = {"targets": lambda: see(targets=permuted, episodes=drawn)}
    failures += compare(see(episodes=drawn), {}, other)
    images = knowarm.make("irb120", 2, **options).reset(seed=seed)[0]
    failures += compare(images, {"tensors": tensors}, {})
    every = np.arange(len(triples))
    return failures + compare(asked(every), {"triples": lambda: asked(every[::-1])}, {})


def load_agent(doors: Doors, random: Random) -> list[str]:
    """`load_agent(...).act`: images, the order of episodes, the infos of a reset."""
    agent, names = doors.trained, random.choice(doors.rows, 4).tolist()
    images, order = picture(random, 4), random.permutation(4)

    def play(images, names=names[0]):
        agent.reset({"query": names})
        return agent.act(images)

    def permuted():
        return play(images[order], np.array(names)[order])[np.argsort(order)[0]]

    same, other = image_forms(images[0], play)
    seen = {"other": images[1], "image": images[0]}
    same = {**same, "one of four": lambda: play(images, names)[0], "permuted": permuted}
    same = {**same, "observations": lambda: play(seen, np.array(names[:1]))}
    return compare(
        play(images[0]), same, {**other, "names": lambda: play(images[:1], names[:2])}
    )


def onnx_runner(doors: Doors, random: Random) -> list[str]:
    """The exported runner: order of joints and rows, and a contract that was changed."""
    runner, image = Runner.load(doors.exported), picture(random, 1)
    start, row, path = (
        home(runner),
        str(random.choice(doors.rows)),
        doors.exported / "contract.json",
    )
    another, text = reordered(runner, random), path.read_text()

    def play(image=image, joints=start, runner=runner):
        runner.reset(Start(joints, row))
        runner.act({"image": image})
        return by_name(runner, runner.targets[0])

    def changed(part, name):
        contract = json.loads(text)
        contract[part][name] = random.permutation(contract[part][name]).tolist()
        path.write_text(json.dumps(contract))
        try:
            return play(runner=Runner.load(doors.exported))
        finally:
            path.write_text(text)

    same, other = image_forms(image, play)
    joints = {
        "joints": shuffled(start, random),
        "more joints": {"finger": 9.0, **start},
    }
    same = {**same, **forms(joints, lambda each: play(joints=each))}
    fields = [("joints", each) for each in ("names", "lower", "upper", "increments")]
    fields += [("knowledge", "rows"), ("workspace_m", "upper")]
    other = {
        **other,
        **forms({each[1]: each for each in fields}, lambda each: changed(*each)),
    }
    return compare(
        play(), {**same, "another order": lambda: play(runner=another)}, other
    )


def serve(doors: Doors, random: Random) -> list[str]:
    """`knowarm serve` and its client: order of keys and joints, and types."""
    runner, image = doors.parts.runner(), picture(random)
    another, row = reordered(runner, random), str(random.choice(doors.rows))
    env = ArmVectorEnv(CELL.env, 1)
    env.reset(options={"episodes": CELL.episodes[:1]})

    def ask(image=image, runner=runner, state=None, **more):
        state = np.array([*home(runner).values()]) if state is None else state
        seen = {
            "observation/image": image,
            "observation/state": state,
            "prompt": row,
            **more,
        }
        return by_name(
            runner,
            Episode(runner).answer(shuffled({**seen, "reset": True}, random))[
                "actions"
            ][0],
        )

    def levels(runner):
        server = PolicyServer(lambda: runner, port=0)
        threading.Thread(target=server.run, daemon=True).start()
        try:
            client = Client(f"ws://127.0.0.1:{server.port}")
            client.reset(Batch.of(env))
            return client.act(
                {"image": image[None], "joint_targets": env.joint_targets}
            )
        finally:
            server.close()

    same, other = image_forms(image, ask)
    same = {
        **same,
        "list": lambda: ask(state=[*home(runner).values()]),
        "more": lambda: ask(a=1),
    }
    same = {**same, "another order": lambda: ask(runner=another)}
    failures = compare(ask(), same, {**other, "map": lambda: ask(state=home(runner))})
    return failures + compare(levels(runner), {}, {"server": lambda: levels(another)})


def ros(doors: Doors, random: Random) -> list[str]:
    """The driver of `knowarm ros`: order of joints and channels, padding, types."""
    image, row = picture(random), str(random.choice(doors.rows))
    start, middle = (
        home(doors.parts.runner()),
        doors.parts.contract["workspace_m"]["upper"],
    )

    def drive(image=image, joints=start, order=lambda runner: runner):
        safety = Safety(confirm_steps=0)
        driver = Driver(
            order(doors.parts.runner()), lambda angles: np.array(middle), safety, row
        )
        driver.see(image, 1.0)
        driver.feel(list(joints), list(joints.values()), 1.0)
        targets = driver.tick(1.0)
        if targets is None:
            raise ValueError(driver.end or driver.status)
        return sorted(zip(driver.joint_names, targets.tolist(), strict=True))

    def message(encoding, pixels=image, padding=0):
        padded = np.pad(pixels.reshape(64, -1), ((0, 0), (0, padding)))
        return drive(decoded(encoding, 64, 64, padded.shape[1], padded.tobytes()))

    same, other = image_forms(image, drive)
    joints = {
        "joints": shuffled(start, random),
        "more joints": {"finger": 9.0, **start},
    }
    same = {**same, **forms(joints, lambda each: drive(joints=each))}
    same = {
        **same,
        "another order": lambda: drive(order=lambda each: reordered(each, random)),
    }
    same = {**same, "rgb8": lambda: message("rgb8", padding=5)}
    same = {**same, "bgr8": lambda: message("bgr8", image[..., ::-1])}
    opaque = np.pad(image, ((0, 0), (0, 0), (0, 1)), constant_values=255)
    same = {**same, "rgba8": lambda: message("rgba8", opaque, padding=5)}
    return compare(
        drive(), same, {**other, "yuv422": lambda: message("yuv422", padding=64)}
    )


def benchmark(doors: Doors, random: Random) -> list[str]:
    """The benchmark: an exported folder with another order of joints, and a row's own order."""
    env, image = ArmVectorEnv(CELL.env, 2), picture(random, 2)
    env.reset(options={"episodes": CELL.episodes[:2]})
    runner, path = Runner.load(doors.exported), doors.folder / "row.json"
    row = json.loads(
        sorted(ROWS.iterdir())[random.integers(len([*ROWS.iterdir()]))].read_text()
    )

    def levels(runner):
        with mock.patch.object(Runner, "load", return_value=runner):
            agent = entrant(str(doors.exported)).make(CELL, env)
        agent.reset(Batch.of(env))
        return agent.act({"image": image, "joint_targets": env.joint_targets})

    def figures(row):
        path.write_text(json.dumps(row))
        return rows.read_row(path)

    failures = compare(
        levels(runner), {}, {"joints": lambda: levels(reordered(runner, random))}
    )
    other = {"fields": shuffled(row, random)}
    other["cells"] = row | {"cells": shuffled(row["cells"], random)}
    return failures + compare(figures(row), {}, forms(other, figures))


def lerobot(doors: Doors, random: Random) -> list[str]:
    """The LeRobot plugin, on a stub of LeRobot: actions of other types, order of seeds."""
    config = type("EnvConfig", (), {"register_subclass": lambda name: lambda cls: cls})
    stub = {
        "FeatureType": SimpleNamespace(),
        "PolicyFeature": dict,
        "EnvConfig": config,
    }
    stub |= {"ACTION": "action", "OBS_IMAGE": "image", "OBS_STATE": "state"}
    modules = ("", ".configs", ".envs", ".envs.configs", ".utils", ".utils.constants")
    fake = {f"lerobot{name}": ModuleType(f"lerobot{name}") for name in modules}
    for module in fake.values():
        vars(module).update(stub)
    plugin = str(ROOT / "plugins" / "lerobot_env_knowarm")
    with (
        mock.patch.dict(sys.modules, fake),
        mock.patch.object(sys, "path", [plugin, *sys.path]),
    ):
        from lerobot_env_knowarm import BenchmarkEnv
    env, number = BenchmarkEnv("reach-v1", "irb120-fixed"), int(random.integers(100))
    wanted = random.uniform(-0.5, 0.5, 6)

    def play(action, before=()):
        for seed in (*before, number):
            env.reset(seed=seed)
        seen, reward, *_ = env.step(action)
        return [reward, *seen["pixels"].ravel(), *seen["agent_pos"].ravel()]

    same = forms({"list": wanted.tolist(), "float32": wanted.astype(np.float32)}, play)
    same = {
        **same,
        "other seeds before": lambda: play(wanted, random.integers(0, 99, 3).tolist()),
    }
    other = [wanted[:1], wanted[None], wanted[:, None], wanted[:5], np.float64(0.1)]
    other += [
        np.where(np.arange(6) == random.integers(6), each, wanted)
        for each in (np.nan, np.inf)
    ]
    return compare(
        play(wanted), same, forms({f"action {each}": each for each in other}, play)
    )


def ask(doors: Doors, random: Random) -> list[str]:
    """`knowarm ask`: order of triples and of the parts of a question."""
    triples, first, second = (
        list(shipped_graph("objects")),
        "usedFor drinking",
        "hasColor blue",
    )
    every = np.arange(len(triples))

    def answers(question=f"{first} and {second}", order=every):
        asker = Asker(doors.trained, graph_of([triples[i] for i in order]))
        found = asker.answers(question)
        return [found.satisfies.tolist(), asker.scene([found]), sorted(found.evidence)]

    orders = {"triples": random.permutation(every), "one twice": [*every, 0]}
    questions = {"parts": f"{second} and {first}", "spaces": f"  {first}  and {second}"}
    same = {
        **forms(orders, lambda each: answers(order=each)),
        **forms(questions, answers),
    }
    return compare(answers(), same, {})


DOORS = [
    gymnasium_ids,
    make,
    load_agent,
    onnx_runner,
    serve,
    ros,
    benchmark,
    lerobot,
    ask,
]


@pytest.fixture(scope="module")
def doors(trained, tmp_path_factory, exported_zoo):
    folder = tmp_path_factory.mktemp("doors")
    made = Doors(trained, folder)
    source = exported_zoo(trained.config.name)
    made.exported = Path(shutil.copytree(source, folder / "exported"))
    return made


@pytest.mark.parametrize("door", DOORS, ids=lambda door: door.__name__)
def test_another_form_of_the_input_changes_nothing_or_is_refused(doors, door):
    assert door(doors, np.random.default_rng(0)) == []
