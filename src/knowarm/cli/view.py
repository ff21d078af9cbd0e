"""``knowarm view``: an agent in the web viewer, as a video or as a film strip."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import tyro

from knowarm.cli.evaluate import is_scripted
from knowarm.cli.tables import FilePath
from knowarm.errors import UserError
from knowarm.experiment.build import load_agent
from knowarm.experiment.graph_queries import GraphQueries
from knowarm.world.agents import SCRIPTED_AGENTS, AgentProtocol
from knowarm.world.choice_config import ChoiceConfig
from knowarm.world.config import EnvConfig, choice_env_config
from knowarm.world.episodes import evaluation_episodes
from knowarm.world.record import describe_episode, record_episode, write_strip, write_video
from knowarm.world.robots import DEFAULT_ROBOT
from knowarm.world.scene import find_robot
from knowarm.world.vector_env import ReachVectorEnv
from knowarm.world.watch import watch


@dataclass(frozen=True, kw_only=True)
class View:
    """Show an agent in MuJoCo's web viewer, or record it."""

    robot: Annotated[
        str | None, tyro.conf.Positional, tyro.conf.arg(metavar="[ROBOT]", help_behavior_hint="")
    ] = None
    """Robot (see `knowarm list`) or TOML file of a robot of your own; a run has its own."""
    agent: Annotated[str, tyro.conf.arg(metavar="AGENT")] = "oracle"
    """A scripted agent (see `knowarm list`), or a run folder."""
    episodes: int = 6
    """Number of episodes; the viewer plays them again and again until Ctrl-C."""
    seed: int = 0
    """Seed of the episodes, and of the actions of a stochastic agent."""
    choose: bool = False
    """Show a scripted agent several objects, of which a query means one; a run has its own task."""
    targets: tuple[str, ...] = ()
    """Objects to reach, by name or TOML file. Default: all, or the run's."""
    colours: Literal["fixed", "randomized"] | None = None
    """Colours of the objects. Default: fixed, or the run's."""
    dynamics: Literal["dynamic", "kinematic"] | None = None
    """Motion of the arm: simulated servos, or exact positions. Default: dynamic, or the run's."""
    video: FilePath = None
    """Write an .mp4 video of the policy's images beside a large view, instead of the viewer."""
    strip: FilePath = None
    """Write an image with one film strip per episode, instead of opening the viewer."""
    host: str = "127.0.0.1"
    """Address on which the web viewer listens. Others than this machine's own, such as 0.0.0.0, are
    reachable over the network by whoever has the token in the printed address."""
    port: int = 0
    """Port of the web viewer; 0 takes the first free port from 8080."""
    browser: bool = True
    """Open the web viewer in the browser."""

    def run(self) -> None:
        """Play the episodes and show or record them."""
        if self.episodes < 1:
            raise UserError(f"--episodes must be at least 1, got {self.episodes}.")
        make_agent, config = self._agent()
        env = ReachVectorEnv(self._env_config(config), 1)
        episodes = evaluation_episodes(env.scene, env.config, self.episodes, self.seed)
        agent = make_agent()
        if self.video is None and self.strip is None:

            def announce(number: int) -> None:
                wanted = describe_episode(env)
                print(f"Episode {number + 1} of {len(episodes)}: {wanted}", flush=True)

            print("Waiting for a browser. Press Ctrl-C to stop.", flush=True)
            watch(
                agent,
                env,
                episodes,
                host=self.host,
                port=self.port,
                open_browser=self.browser,
                on_episode=announce,
            )
            return
        films = [record_episode(agent, env, episodes[i : i + 1]) for i in range(len(episodes))]
        reached = sum(film[-1].success for film in films)
        print(f"{reached} of {len(films)} episodes reached their target.")
        if self.video is not None:
            write_video(self.video, films)
            print(f"Wrote {self.video}")
        if self.strip is not None:
            write_strip(self.strip, films)
            print(f"Wrote {self.strip}")

    def _agent(self) -> tuple[Callable[[], AgentProtocol], EnvConfig]:
        """Return a constructor of the agent, and its environment's config."""
        if is_scripted(self.agent):
            robot = self.robot or DEFAULT_ROBOT
            config = EnvConfig(robot=robot)
            if self.choose:
                config = choice_env_config(robot, choice=ChoiceConfig(queries=GraphQueries()))
            return lambda: SCRIPTED_AGENTS[self.agent].make(self.seed), config
        trained = load_agent(self.agent, seed=self.seed)
        config = trained.config.env
        if self.robot is not None and find_robot(self.robot) != find_robot(config.robot):
            raise UserError(
                f"The run {self.agent} was trained on robot {config.robot!r}, not on "
                f"{self.robot!r}: leave out the robot."
            )
        return lambda: trained.agent, config

    def _env_config(self, config: EnvConfig) -> EnvConfig:
        return replace(
            config,
            targets=self.targets or config.targets,
            colours=self.colours or config.colours,
            dynamics=self.dynamics or config.dynamics,
        )
