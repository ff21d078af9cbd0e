"""``knowarm export``, ``serve``, ``ros`` and ``record``: a policy outside of the simulator."""

import logging
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Self

import tyro
from tyro.conf import OmitArgPrefixes, Positional, arg

from knowarm.cli.evaluate import is_scripted, parse_with_task
from knowarm.cli.tables import FilePath
from knowarm.config import file_name
from knowarm.deploy.contract import Deployment, deployment, export, tcp_position
from knowarm.deploy.driver import Driver, Safety, Topics
from knowarm.deploy.record import record
from knowarm.errors import shell_command
from knowarm.experiment.config import Which
from knowarm.experiment.load import TrainedAgent, load_agent
from knowarm.world.agents import SCRIPTED_AGENTS, AgentProtocol
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv


@dataclass(frozen=True, kw_only=True)
class OfRun:
    """Command on the policy of a run."""

    run_folder: Annotated[Positional[Path], arg(metavar="RUN")]
    """Run folder, such as runs/irb120-full-fast/0."""
    which: Which = "best"
    """Checkpoint of the run: best interim evaluation, latest, or untrained."""
    joint_map: FilePath = None
    """TOML file with the real arm's joints, ``[joint_map]``. Default: that of the robot."""

    def trained(self) -> TrainedAgent:
        """Load the policy of the run."""
        return load_agent(self.run_folder, which=self.which)

    def deployment(self) -> Deployment:
        """Take the policy apart."""
        return deployment(self.trained(), self.joint_map)


@dataclass(frozen=True, kw_only=True)
class Export(OfRun):
    """Write a trained policy as ONNX, with its contract and a runner without PyTorch."""

    to: Annotated[Path, arg(metavar="DIR")] = Path("exported")
    """Folder to write."""

    def run(self) -> None:
        """Export and say what was written."""
        contract = export(self.trained(), self.to, self.joint_map).contract
        names = sorted(["contract.json", "runner.py", *contract["digests"]])
        print(f"Wrote {', '.join(names)} to {self.to}.")
        rows = contract["knowledge"]["rows"]
        more = " and more" if len(rows) > 3 else ""
        print(f"knowledge.npy: vectors of {', '.join(rows[:3])}{more}.")
        if not contract["success"]:
            print(
                f"Not evaluated: `{shell_command('evaluate', self.run_folder)}` adds its success."
            )


@dataclass(frozen=True, kw_only=True)
class Serve(OfRun):
    """Serve a trained policy over the WebSocket protocol of openpi, until Ctrl-C."""

    host: str = "127.0.0.1"
    """Address to listen on. Others than the loopback need a key, in KNOWARM_SERVE_KEY."""
    port: int = 8000
    """Port; 0 takes a free one."""
    resize: bool = False
    """Average the central square of larger images to the policy's size."""

    def run(self) -> None:
        """Serve and print the address."""
        from knowarm.deploy.serve import PolicyServer, log

        logging.basicConfig(format="%(asctime)s %(message)s", datefmt="%H:%M:%S")
        log.setLevel(logging.INFO)
        server = PolicyServer(
            self.deployment().runner,
            host=self.host,
            port=self.port,
            key=os.environ.get("KNOWARM_SERVE_KEY") or None,
            resize=self.resize,
        )
        print(
            f"Serving {self.run_folder} on ws://{self.host}:{server.port} until Ctrl-C.",
            flush=True,
        )
        server.run()


@dataclass(frozen=True, kw_only=True)
class Ros(OfRun):
    """Drive a robot for one episode over ROS 2, with safety rules before every motion."""

    knowledge: str | None = None
    """Row of the knowledge table, such as "usedFor drinking"; not needed where it never changes."""
    safety: Annotated[Safety, OmitArgPrefixes] = field(default_factory=Safety)
    """What must hold before a joint target is sent."""
    resize: bool = False
    """Average the central square of larger images to the policy's size."""
    topic: Topics = field(default_factory=Topics)

    def run(self) -> None:
        """Drive until the last step, a broken rule, or a stop."""
        from knowarm.deploy.ros import drive

        parts = self.deployment()
        driver = Driver(
            parts.runner(),
            partial(tcp_position, parts.scene),
            self.safety,
            self.knowledge,
            resize=self.resize,
        )
        drive(driver, self.topic)


@dataclass(frozen=True, kw_only=True)
class Record:
    """Record episodes as a LeRobotDataset v3: Parquet files with PNG images."""

    agent: Annotated[Positional[str], arg(metavar="AGENT")]
    """A run folder (runs/irb120-full-fast/0), or a scripted agent (see `knowarm list`)."""
    to: Annotated[Path, arg(metavar="DIR")]
    """New folder of the dataset."""
    episodes: int = 100
    """Number of episodes."""
    seed: int = 0
    """Seed of the episodes."""
    camera: str = ""
    """Name of the camera: images are in observation.images.NAME. Default: observation.image."""
    joint_map: FilePath = None
    """TOML file with the real arm's joints, ``[joint_map]``. Default: that of the robot."""
    env: EnvConfig = field(default_factory=EnvConfig)
    """Environment of a scripted agent; a run has its own."""

    @classmethod
    def parse(cls, prog: str, arguments: Sequence[str]) -> Self:
        """Make a command from its options; `--env.task` takes the name of a task."""
        return parse_with_task(
            cls, prog, arguments, agent=tyro.MISSING, to=tyro.MISSING
        )

    def run(self) -> None:
        """Play, write and say how many episodes succeeded."""
        if self.camera:
            file_name(self, "camera")
        trained = None if is_scripted(self.agent) else load_agent(self.agent)
        config = self.env if trained is None else trained.config.env
        env = ArmVectorEnv(config, min(self.episodes, 100))
        if trained is None:
            agent: AgentProtocol = SCRIPTED_AGENTS[self.agent].make(env, self.seed)
        else:
            agent = trained.player
        solved = record(
            agent,
            env,
            evaluation_episodes(config, self.episodes, self.seed),
            self.to,
            camera=self.camera,
            joint_map=self.joint_map,
        )
        print(
            f"Wrote {self.episodes} episodes to {self.to}; {solved} of them succeeded."
        )
