"""Physics of placing: success by time step and friction, and what touches the object.

python -m benchmarks.place_physics --robot tiago --episodes 100
"""

import argparse
from collections import Counter
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from knowarm.statistics import wilson
from knowarm.world.agents.protocol import Batch
from knowarm.world.agents.scripted import OracleAgent
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.tasks.asked.query.query import AskObject
from knowarm.world.tasks.skills.lift.model import (
    FINGERS,
    TIMESTEP_S,
    LiftScene,
    build_lift_scene,
)
from knowarm.world.tasks.skills.place.place import Place
from knowarm.world.tasks.skills.place.tray import add_trays, centres_m
from knowarm.world.tasks.task import Task

SEED = 7
TIMESTEPS_MS = (2.0, 4.0)
FRICTIONS = (0.7, 1.0)


@dataclass(frozen=True, kw_only=True)
class FinePlace(Place):
    """Placing with another time step and another sliding friction of the fingers."""

    def at(self, timestep_ms: float, friction: float) -> "FinePlace":
        """Return the skill with a time step [ms] and a friction."""

        def build_scene(robot: Any, targets: Any, distractors: int) -> LiftScene:
            furnish = add_trays(robot, centres_m(robot)[:1])
            timestep_s = timestep_ms / 1000
            scene = build_lift_scene(robot, targets, distractors, timestep_s, furnish)
            model = scene.model
            for name in FINGERS:
                body = model.body(name).id
                model.geom_friction[model.geom_bodyid == body, 0] = friction
            return scene

        object.__setattr__(self, "build_scene", build_scene)
        return self


class Contacts:
    """What touches the objects that are meant, and how deep they are in it [m]."""

    def __init__(self, env: ArmVectorEnv) -> None:
        self._env = env
        self._model = env.scene.model
        self._data = mujoco.MjData(self._model)
        self.depth: dict[str, float] = {}
        self.steps = Counter[str]()

    def look(self, running: np.ndarray) -> None:
        """Look at the present state of the running episodes."""
        state = self._env.running
        for number in np.flatnonzero(running).tolist():
            state.simulator.batch.get_data(number, self._data)
            mujoco.mj_forward(self._model, self._data)
            target = state.target[number]
            of_step: dict[str, float] = {}
            for contact in self._data.contact:
                is_target = self._env.scene.geom_target[contact.geom] == target
                if is_target.sum() != 1:
                    continue
                other = self._kind(int(contact.geom[int(is_target[0])]))
                of_step[other] = max(of_step.get(other, 0.0), -float(contact.dist))
            for other, depth in of_step.items():
                self.steps[other] += 1
                self.depth[other] = max(self.depth.get(other, 0.0), depth)

    def _kind(self, geom: int) -> str:
        body = self._model.body(self._model.geom_bodyid[geom]).name
        if self._env.scene.geom_target[geom] >= 0:
            return "another object"
        if body in FINGERS:
            return "fingers"
        if body.startswith("robot/"):
            return f"arm ({body})"
        return self._model.geom(geom).name or body


def row(robot: str, timestep_ms: float, friction: float, episodes: int) -> str:
    """Let the oracle place; return its success, and what touched the objects."""
    skill = FinePlace().at(timestep_ms, friction)
    config = EnvConfig(robot=robot, task=Task(asked=AskObject(), skill=skill))
    env = ArmVectorEnv(config, episodes)
    assert env.scene.model.opt.timestep == timestep_ms / 1000
    fixed = evaluation_episodes(config, episodes, SEED)
    env.reset(options={"episodes": fixed})
    agent = OracleAgent(env)
    agent.reset(Batch.of(env))
    contacts = Contacts(env)
    running = np.ones(episodes, bool)
    success = np.zeros(episodes, bool)
    is_standard = timestep_ms == 1000 * TIMESTEP_S and friction == 1.0
    while running.any():
        _, _, terminated, truncated, infos = env.advance(
            agent.act({}), np.zeros(episodes, bool)
        )
        success |= running & infos["is_success"]
        running &= ~(terminated | truncated)
        if is_standard:
            contacts.look(running)
    share = wilson(int(success.sum()), episodes)
    line = (
        f"{robot}, {timestep_ms:g} ms, friction {friction:g}: {100 * share.estimate:.1f} % "
        f"[{100 * share.low:.0f}, {100 * share.high:.0f}]"
    )
    for other, steps in contacts.steps.most_common():
        depth = 1000 * contacts.depth[other]
        line += f"\n  {other}: {steps} control periods, at most {depth:.1f} mm deep"
    return line


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robot", default="tiago")
    parser.add_argument("--episodes", type=int, default=100)
    given = parser.parse_args()
    for timestep_ms in TIMESTEPS_MS:
        print(row(given.robot, timestep_ms, 1.0, given.episodes), flush=True)
    print(row(given.robot, 1000 * TIMESTEP_S, FRICTIONS[0], given.episodes))


if __name__ == "__main__":
    main()
