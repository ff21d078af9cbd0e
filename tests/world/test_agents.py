"""Interface of agents: one pair of methods, and inputs that follow from the class."""

import ast
import inspect

import numpy as np
import pytest

from knowarm.errors import UserError
from knowarm.world.agents import SCRIPTED_AGENTS, Batch, PrivilegedAgent
from knowarm.world.config import EnvConfig
from knowarm.world.envs.vector_env import ArmVectorEnv
from tests.source_tree import modules

OTHER_PAIRS = {"start", "step", "choose", "begin"}
PLAYERS = {
    "TrainedAgent",
    "PolicyAgent",
    "OracleAgent",
    "Runner",
    "Client",
    "OnnxPolicy",
}


def classes():
    """Yield name and methods of every class of the source."""
    for tree in modules().values():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                methods = [
                    each for each in node.body if isinstance(each, ast.FunctionDef)
                ]
                yield node.name, {each.name: each for each in methods}


def test_all_that_plays_has_reset_and_act_and_no_other_pair():
    assert not [
        name for name, methods in classes() if {"start", "step"} <= set(methods)
    ]
    found = {name: methods for name, methods in classes() if "act" in methods}
    assert set(found) >= PLAYERS
    for place, methods in found.items():
        assert not OTHER_PAIRS & set(methods), place
        for name, argument in (("reset", "batch"), ("act", "observations")):
            if name == "act" or name in methods:  # subclasses inherit `reset`
                given = [each.arg for each in methods[name].args.args]
                assert given == ["self", argument], (place, name)


@pytest.fixture(scope="module")
def envs():
    """Two environments of the same task in different episodes."""
    found = []
    for seed in (1, 2):
        env = ArmVectorEnv(EnvConfig(image_size=8, dynamics="kinematic"), 3)
        env.reset(seed=seed)
        found.append(env)
    return found


@pytest.mark.parametrize("name", SCRIPTED_AGENTS)
def test_class_and_declared_inputs_agree(name, envs, monkeypatch):
    monkeypatch.setattr(
        "knowarm.world.agents.search_open_loop", lambda config, seed: LIST
    )
    entry = SCRIPTED_AGENTS[name]
    agents = [entry.make(env, 0) for env in envs]
    assert {type(agent) for agent in agents} == {entry.kind}
    privileged = issubclass(entry.kind, PrivilegedAgent)
    assert ("env" in inspect.signature(entry.kind).parameters) == privileged
    assert entry.kind.inputs == (("simulator",) if privileged else ())
    batch = Batch.of(envs[0])
    agents[0].reset(batch)
    first = agents[0].act({})
    assert first.shape == (3, 6)
    if privileged:
        with pytest.raises(UserError, match="made for another environment"):
            agents[1].reset(batch)
    else:  # told the same, they do the same in every state of the simulator
        agents[1].reset(batch)
        np.testing.assert_array_equal(agents[1].act({}), first)


LIST = np.ones((50, 6), np.int64)
