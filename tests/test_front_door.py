"""Public names of the package: each has an example here, and importing the package is cheap."""

import ast
import inspect
import re
import subprocess
import sys
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from types import FunctionType

import gymnasium
import numpy as np
import pytest
import torch
from sphinx.pycode import ModuleAnalyzer

import knowarm
from knowarm.errors import UserError
from knowarm.experiment.summary import read_film
from knowarm.reading import read_json
from tests.study.tiny import InlineExecutor
from tests.tiny import TINY

SOURCE = Path(knowarm.__file__).parent
ZOO = SOURCE.parents[1] / "zoo" / "irb120-full-fast"
CHOOSE = "irb120-choose-subgraph-fast"
EXAMPLES = {}


def example(*names):
    """Register the test below as the example of these names."""

    def register(function):
        for name in names:
            EXAMPLES[name] = function
        return function

    return register


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return knowarm.train("irb120-full-ppo", tmp_path_factory.mktemp("runs"), **TINY)


def test_importing_the_package_imports_nothing_heavy():
    heavy = {
        "torch",
        "mujoco",
        "numba",
        "scipy",
        "pyarrow",
        "PIL",
        "tyro",
        "rich",
        "jinja2",
    }
    code = "import sys, gymnasium; before = set(sys.modules); import knowarm; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert heavy & {name.split(".")[0] for name in loaded} == set()
    assert len([name for name in loaded if name.startswith("knowarm")]) <= 20


def test_every_public_name_has_an_example_and_a_line_of_help():
    assert set(EXAMPLES) == set(knowarm.__all__) == set(dir(knowarm))
    for name in knowarm.__all__:
        assert name in knowarm.__doc__
        value = getattr(knowarm, name)
        if callable(value):
            assert value.__doc__
            assert not value.__doc__.startswith(f"{name}(")


def undocumented(value):
    """Return the public members of a class for which the API reference would have no words."""
    members, described = set(), set()
    for each in value.__mro__:
        own = {*vars(each), *vars(each).get("__annotations__", {})}
        if not each.__module__.startswith(("knowarm", __name__)):
            described |= own  # of Gymnasium, say
            continue
        members |= {name for name in own if not name.startswith("_")}
        attributes = ModuleAnalyzer.for_module(each.__module__).find_attr_docs()
        described |= {name for owner, name in attributes if owner == each.__name__}
        described |= set(re.findall(r"^ +(\w+): ", each.__doc__ or "", re.MULTILINE))
        described |= {
            name
            for name in own
            if isinstance(vars(each).get(name), METHODS)
            and inspect.getdoc(vars(each)[name])
        }
    return members - described


METHODS = (FunctionType, classmethod, staticmethod, property, cached_property)


class Silent(knowarm.Run):
    """Public names with and without words."""

    spoken = 3  #: Words.
    silent = 3

    def method(self):
        pass


def test_every_public_name_and_member_is_in_the_reference():
    assert undocumented(Silent) == {"silent", "method"}
    folder = SOURCE.parents[1] / "docs" / "reference"
    pages = "".join(
        path.read_text(encoding="utf-8") for path in folder.glob("api/*.md")
    )
    for pattern, text in (
        (r":: knowarm\.(\w+)$", pages),
        (r"^   knowarm\.(\w+)$", pages),  # tables at their tops
        (r"`(\w+)`", (folder / "api.md").read_text(encoding="utf-8").partition("|")[2]),
    ):
        names = re.findall(pattern, text, re.MULTILINE)
        wanted = knowarm.__all__
        if pattern.startswith("^"):  # registries have the words of `dict` and `tuple`
            wanted = [
                name
                for name in wanted
                if not isinstance(getattr(knowarm, name), dict | tuple)
            ]
        assert sorted(names) == sorted(wanted), pattern
    classes = [
        each
        for name in knowarm.__all__
        if inspect.isclass(each := getattr(knowarm, name))
    ]
    found = {each.__name__: undocumented(each) for each in classes}
    assert not {name: members for name, members in found.items() if members}


def test_no_public_name_is_the_name_of_a_package():
    packages = {path.stem for path in SOURCE.iterdir() if path.suffix in ("", ".py")}
    assert packages & set(knowarm.__all__) == set()


def test_the_stub_imports_what_exists():
    tree = ast.parse((SOURCE / "__init__.pyi").read_text())
    names = [
        alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    ]
    assert sorted(names) == sorted(knowarm.__all__)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="trane"):
        knowarm.trane  # noqa: B018


@example("train", "Run")
def test_train(run):
    assert isinstance(run, knowarm.Run)
    assert run.result.step == 40
    longer = knowarm.train(
        run.folder.experiment(), run.folder.path.parents[1], resume=True, total_steps=60
    )
    assert longer.result.step == 60
    with pytest.raises(knowarm.UserError, match="resume=True"):
        knowarm.train("irb120-full-ppo", run.folder.path.parents[1], **TINY)


@example("evaluate", "EvaluationResult", "EvaluationConfig")
def test_evaluate(run):
    config = knowarm.EvaluationConfig(
        episodes=4, probes=[{"kind": "films", "episodes": 1}]
    )
    result = knowarm.evaluate(run, config=config)
    assert isinstance(result, knowarm.EvaluationResult)
    assert len(result.episodes["return"]) == 4
    folder = run.folder.path / "evaluation" / "post-training-greedy"
    assert result.folder == folder
    assert repr(result).startswith(
        "EvaluationResult(irb120-full-ppo/0, post-training-greedy: 4 "
    )
    assert len(repr(result)) < 120
    assert read_film(folder / "films" / "0.webp").shape[1:] == (64, 64, 3)
    again = knowarm.evaluate(run.folder.path, config=config, episodes=2, write=False)
    assert again.summary["episodes"] == 2
    assert read_json(folder / "summary.json")["numbers"]["episodes"] == 4
    with pytest.raises(knowarm.UserError, match="'episodes'"):
        knowarm.evaluate(run.folder.path, episode=2)


@example("load_agent", "TrainedAgent", "PolicyAgent")
def test_load_agent():
    trained = knowarm.load_agent(ZOO)
    assert isinstance(trained, knowarm.TrainedAgent)
    assert isinstance(trained.agent, knowarm.PolicyAgent)
    config = knowarm.EvaluationConfig(episodes=4, probes=())
    result = knowarm.evaluate(trained, config=config, write=False)
    assert result.summary.agent == "irb120-full-fast/0"
    assert result.summary["success"] > 0


def test_a_trained_agent_plays_environments_from_the_infos_of_their_resets():
    trained = knowarm.load_agent(ZOO)
    envs = knowarm.make("irb120", num_envs=8)
    images, infos = envs.reset(seed=0)
    trained.reset(infos)
    assert trained.act(images).shape == (8, 6)
    episodes = knowarm.evaluation_episodes(envs.config, 8, seed=1)
    agents = (trained, trained.agent)
    whole, part = (knowarm.play(each, envs, episodes).steps.actions for each in agents)
    np.testing.assert_array_equal(whole, part)
    for wrong in (
        images / 255,
        images[:, ::2, ::2],
        images.transpose(0, 3, 1, 2),
        [1, 2],
    ):
        trained.reset(infos)
        with pytest.raises(
            knowarm.UserError, match=r"image must be \(64, 64, 3\) uint8"
        ):
            trained.act(wrong)
    trained.reset(infos)
    trained.act(images)
    with pytest.raises(
        knowarm.UserError, match="8 episodes have started, and there are 1 images"
    ):
        trained.act(images[0])
    chooser = knowarm.load_agent(ZOO.parent / CHOOSE)
    image, info = gymnasium.make("knowarm/IRB120Choose-v0").reset(seed=0)
    with pytest.raises(knowarm.UserError, match="0 episodes have started"):
        chooser.act(image)
    for asked in (info, {"query": "usedFor drinking"}):
        chooser.reset(asked)
        assert chooser.act(image).shape == (6,)
    with pytest.raises(knowarm.UserError, match="info 'query'"):
        chooser.reset({})


@example("ask", "Asked")
def test_ask():
    run = ZOO.parent / "irb120-choose-answers-fast"
    found = knowarm.ask(run, "usedFor drinking and not hasColor blue")
    assert isinstance(found, knowarm.Asked)
    assert found.right
    assert "which answers" in found.outcome
    edit = ["- mug usedFor drinking", "+ lamp usedFor drinking"]
    edited = knowarm.ask(run, "usedFor drinking", edit=edit)
    assert edited.reached[0] == "lamp"
    again = knowarm.ask(run, "usedFor drinking", scene=edited.scene)
    assert again.reached == edited.shown[1]
    one = knowarm.ask(run, "usedFor drinking", edit="- mug usedFor drinking")
    assert "mug" not in {name for name, _ in one.answers.evidence}
    with pytest.raises(knowarm.UserError, match="Unknown value of unclear 'maybe'"):
        knowarm.ask(run, "usedFor drinking", unclear="maybe")
    with pytest.raises(knowarm.UserError, match="must be 0 to 3999, got 'a'"):
        knowarm.ask(run, "usedFor drinking", scene="a")


@example("write_report")
def test_write_report(run, tmp_path):
    page = knowarm.write_report(run.folder.path, tmp_path / "report.html")
    assert "<html" in page.read_text()


@example("experiment_config", "experiment_names", "ExperimentConfig")
def test_experiment_config():
    assert "irb120-full-ppo" in knowarm.experiment_names()
    config = knowarm.experiment_config(
        "irb120-full-ppo", seed=3, algorithm={"num_envs": 64}
    )
    assert isinstance(config, knowarm.ExperimentConfig)
    assert (config.seed, config.algorithm.num_envs, config.algorithm.gamma) == (
        3,
        64,
        0.95,
    )
    with pytest.raises(knowarm.UserError, match=r"field of algorithm.*num_envs"):
        knowarm.experiment_config("irb120-full-ppo", algorithm={"num_env": 64})


@example("make", "ArmVectorEnv", "TorchArmVectorEnv")
def test_make():
    image, _ = knowarm.make("irb120", image_size=32).reset(seed=0)
    assert image.shape == (32, 32, 3)
    env = knowarm.make("knowarm/TiagoReach-v0", num_envs=2)
    assert isinstance(env, knowarm.ArmVectorEnv)
    images, infos = env.reset(seed=0)
    env.step(env.action_space.sample())
    assert images.shape == (2, 64, 64, 3)
    assert infos["distance"].shape == (2,)
    tensors = knowarm.make("irb120", num_envs=2, device="cpu")
    assert isinstance(tensors, knowarm.TorchArmVectorEnv)
    assert isinstance(tensors.reset(seed=0)[0], torch.Tensor)


@example("ArmEnv", "Episodes", "evaluation_episodes", "play", "OracleAgent")
def test_play():
    config = knowarm.EnvConfig(image_size=8, dynamics="kinematic")
    episodes = knowarm.evaluation_episodes(config, 6, seed=0)
    assert isinstance(episodes, knowarm.Episodes)
    env = knowarm.ArmVectorEnv(config, 3)
    result = knowarm.play(knowarm.OracleAgent(env), env, episodes)
    assert result.success.all()
    single = knowarm.make("irb120", image_size=8)
    assert isinstance(single, knowarm.ArmEnv)
    assert single.reset(options={"episodes": episodes[:1]})[0].shape == (8, 8, 3)


@example("AskInstance")
def test_families():
    assert knowarm.EnvConfig(task=knowarm.AskInstance()).targets[:2] == (
        "mug-0",
        "mug-1",
    )


@example("Lift")
def test_lift():
    env = knowarm.make("irb120", task=knowarm.Lift(hold_steps=5), image_size=8)
    assert env.action_space.shape == (7,)


@example("AskPart")
def test_purpose():
    assert knowarm.EnvConfig(task=knowarm.AskPart()).targets[:2] == (
        "bottle.stopper",
        "bottle.neck",
    )


class Dip(knowarm.Skill):
    """As `Reach`, by the state's own arrays."""

    def success(self, state: knowarm.EpisodeState):
        """Return which grippers are within the thresholds."""
        return (state.distance <= state.thresholds[0]) & (
            state.angle <= state.thresholds[1]
        )


@example("EpisodeState", "Robot")
def test_the_state_of_episodes_and_the_robot():
    env = knowarm.make("irb120", num_envs=2, image_size=8)
    env.reset(seed=0)
    assert isinstance(env.running, knowarm.EpisodeState)
    np.testing.assert_array_equal(Dip().success(env.running), [False, False])
    robot = env.scene.robot
    assert isinstance(robot, knowarm.Robot)
    assert env.running.joint_targets.shape == (2, len(robot.joints))


@example(
    "Task", "Asking", "AskNothing", "AskObject", "Skill", "Reach", "ASKED", "SKILLS"
)
@example("TASKS", "register_task", "NameQueries", "GraphQueries")
def test_tasks(monkeypatch):
    monkeypatch.setenv("KNOWARM_TASKS", "")
    assert {"reach", "choose", "choose-lift"} <= set(knowarm.TASKS)
    assert {"nothing", "choose"} <= set(knowarm.ASKED)
    assert {"reach", "lift"} <= set(knowarm.SKILLS)
    assert (
        knowarm.register_task("knowarm.world.tasks.skills.reach:Reach") is knowarm.Reach
    )
    assert issubclass(knowarm.AskObject, knowarm.Asking)
    assert issubclass(knowarm.Reach, knowarm.Skill)
    assert knowarm.Task() == knowarm.Task(
        asked=knowarm.AskNothing(), skill=knowarm.Reach()
    )
    env = knowarm.make("irb120", task="choose", num_envs=2, image_size=8)
    assert env.config.task.asked == knowarm.AskObject(queries=knowarm.GraphQueries())
    asked = knowarm.AskObject(objects=3, queries=knowarm.GraphQueries())
    env = knowarm.make("tiago", task=asked, num_envs=2, image_size=8)
    assert env.reset(seed=0)[1]["objects"].shape == (2, 3)


@example("Query", "QuestionTable", "parse_query", "query_embedding")
def test_queries():
    query = knowarm.parse_query("usedFor drinking and hasColor blue")
    assert query == knowarm.Query.of(("usedFor", "drinking"), ("hasColor", "blue"))
    vectors = knowarm.query_embedding(knowarm.experiment_config(CHOOSE).knows, [query])
    assert vectors.table([query]).shape[0] == 1
    table = knowarm.NameQueries().table((("mug", "red"), ("bottle", "blue")), objects=2)
    assert isinstance(table, knowarm.QuestionTable)


@example("SB3VecEnv", "SB3Run", "NumpyToTorch")
def test_adapters():
    shown = {"observe": ("image", "joints", "knowledge"), "knowledge": np.ones((3, 2))}
    single = knowarm.make("irb120", image_size=8, **shown)
    assert set(single.reset(seed=0)[0]) == {"image", "joints", "knowledge"}
    vector = knowarm.make("irb120", 2, image_size=8, **shown)
    assert knowarm.SB3VecEnv(vector, seed=0).reset()["knowledge"].shape == (2, 2)
    with pytest.raises(knowarm.UserError, match="needs a vector environment"):
        knowarm.SB3VecEnv(single)
    assert knowarm.SB3Run(knowarm.experiment_config("irb120-bm-ppo")).verbose == 0
    adapted = knowarm.NumpyToTorch(knowarm.make("irb120", 2, image_size=8))
    assert adapted.reset(seed=0)[0].shape == (2, 8, 8, 3)


@example("VisualRandomization", "HeldOut")
def test_what_varies_and_what_is_held_out():
    looks = knowarm.VisualRandomization(light=0.3, distractors=2)
    held_out = knowarm.HeldOut(colours=("blue", "purple", "light_blue"))
    env = knowarm.make(
        "irb120",
        num_envs=2,
        image_size=8,
        colours="randomized",
        randomization=looks,
        held_out=held_out,
    )
    assert (env.reset(seed=0)[1]["colour"] == 0).all()


@example("GroundingConfig")
def test_perception():
    grounding = knowarm.experiment_config(CHOOSE).knows.grounding
    assert isinstance(grounding, knowarm.GroundingConfig)


@example("EnvConfig", "ROBOTS", "TARGETS")
def test_env_config():
    config = knowarm.EnvConfig(robot="tiago", targets=("mug",), colours="randomized")
    assert config.robot in knowarm.ROBOTS
    assert set(config.targets) <= set(knowarm.TARGETS)


@example("read_graph", "KnowledgeGraph")
def test_read_graph(tmp_path):
    (tmp_path / "graph.tsv").write_text("mug\tisMadeOf\tceramic\nmug\thasColor\tred\n")
    graph = knowarm.read_graph(tmp_path / "graph.tsv")
    assert isinstance(graph, knowarm.KnowledgeGraph)
    assert len(graph) == 2


@example("scene_embedding", "SceneEmbedding", "KnowledgeConfig")
def test_scene_embedding():
    config = knowarm.KnowledgeConfig(detail="full")
    embedding = knowarm.scene_embedding(config, [("mug", "red"), ("bottle", "yellow")])
    assert isinstance(embedding, knowarm.SceneEmbedding)
    assert embedding.vector.shape == (100,)


@example("Policy", "PolicyConfig", "PolicyShape")
def test_policy():
    shape = knowarm.PolicyShape(joints=6, knowledge_dim=150, knowledge_slots=3)
    policy = knowarm.Policy(knowarm.PolicyConfig(fusion="film"), shape, seed=1)
    image = torch.zeros(2, 64, 64, 3, dtype=torch.uint8)
    knowledge, start = torch.zeros(2, 150), torch.ones(2, dtype=torch.bool)
    logits, value, _ = policy.step(image, knowledge, policy.initial_state(2), start)
    assert logits.shape == (2, 6, 7)
    assert value.shape == (2,)


@example(
    "PPOConfig",
    "DistilConfig",
    "A3CConfig",
    "ALGORITHMS",
    "Algorithm",
    "register_algorithm",
)
def test_algorithms():
    assert isinstance(knowarm.ALGORITHMS["ppo"], knowarm.Algorithm)
    assert knowarm.ALGORITHMS["ppo"].config == knowarm.PPOConfig()
    with pytest.raises(
        knowarm.UserError, match="no algorithm: knowarm has another 'PPOConfig'"
    ):
        knowarm.register_algorithm("knowarm:PPOConfig")
    assert knowarm.ALGORITHMS["distil"].config == knowarm.DistilConfig()
    assert knowarm.A3CConfig(workers=2).workers == 2
    with pytest.raises(knowarm.UserError, match="gamma must be between 0 and 1"):
        knowarm.PPOConfig(gamma=1.5)


@example("AGENTS", "Agent")
def test_agents(monkeypatch):
    mine = replace(
        knowarm.AGENTS["full"],
        about="full, two hops",
        knows=knowarm.Vector(detail="full", hops=2),
    )
    assert isinstance(mine, knowarm.Agent)
    monkeypatch.setitem(knowarm.AGENTS, "two-hops", mine)
    assert knowarm.experiment_config("irb120-two-hops-ppo").knows.hops == 2


@example("NoKnowledge", "Vector", "Grounded")
def test_what_an_agent_knows():
    known = {name: agent.knows for name, agent in knowarm.AGENTS.items()}
    assert known["bm"] == knowarm.NoKnowledge()
    for name, kind in (
        ("full", "scene"),
        ("target", "target"),
        ("subgraph-film", "query"),
    ):
        assert isinstance(known[name], knowarm.Vector)
        assert known[name].kind == kind
    for name, kind in (("subgraph", "grounded"), ("answers", "answers")):
        assert isinstance(known[name], knowarm.Grounded)
        assert known[name].kind == kind
    changed = knowarm.experiment_config(CHOOSE, knows={"hops": 0}).knows
    assert (changed.kind, changed.hops) == ("grounded", 0)


@example("UserError")
def test_user_error():
    with pytest.raises(knowarm.UserError, match="Did you mean 'irb120'"):
        knowarm.train("irb12-full-ppo")


@example("StudyConfig", "read_study", "run_study")
def test_run_a_study(tmp_path, monkeypatch):
    monkeypatch.setattr("knowarm.study.driver.make_executor", InlineExecutor)
    study = knowarm.StudyConfig(
        name="mine",
        experiments=("irb120-bm-ppo",),
        seeds=(0,),
        overrides=TINY,
        evaluations=(),
    )
    (status,) = knowarm.run_study(study, tmp_path)
    assert status.state == "done"
    assert knowarm.read_study(tmp_path) == study


@example("push_to_hub", "from_pretrained")
def test_what_is_no_repository_is_refused():
    pytest.importorskip("huggingface_hub")
    with pytest.raises(UserError, match="no repository"):
        knowarm.from_pretrained("no//name")
    with pytest.raises(UserError, match="not a run folder"):
        knowarm.push_to_hub("nowhere", "someone/reach")
