"""``knowarm view``: a robot and an agent go in; a page, a video or a film strip comes out."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from knowarm.errors import UserError, unknown_name
from knowarm.experiment.build import load_agent
from knowarm.world.agents import SCRIPTED_AGENTS, AgentProtocol
from knowarm.world.config import EnvConfig
from knowarm.world.episodes import evaluation_episodes
from knowarm.world.record import record_episode, write_strip, write_video
from knowarm.world.scene import find_robot
from knowarm.world.vector_env import ReachVectorEnv
from knowarm.world.watch import watch


@dataclass(frozen=True, kw_only=True)
class View:
    """Watch an agent in MuJoCo's web viewer, or record it."""

    robot: Annotated[str | None, tyro.conf.Positional] = None
    """irb120, tiago, or the TOML file of a robot of your own; a run brings its own."""
    agent: str = "oracle"
    """zero, random, oracle, or a run folder."""
    episodes: int = 6
    """Episodes to play."""
    seed: int = 0
    """Seed of the episodes, and of an agent that draws."""
    targets: tuple[str, ...] = ()
    """Objects to reach, by name or TOML file; none takes all, or the run's."""
    colours: Literal["fixed", "randomized"] | None = None
    """Colours of the objects; none takes fixed ones, or the run's."""
    dynamics: Literal["dynamic", "kinematic"] | None = None
    """How the arm moves; none takes dynamic, or the run's."""
    video: Path | None = None
    """Record what the policy sees beside a large view into this .mp4 file."""
    strip: Path | None = None
    """Draw a film strip, a row an episode, into this image file."""
    port: int = 0
    """Port of the web viewer; 0 takes the first free one from 8080 on."""
    browser: bool = True
    """Open the web viewer in the browser."""

    def run(self) -> None:
        """Play the episodes and show them."""
        if self.episodes < 1:
            raise UserError(f"--episodes must be at least 1, got {self.episodes}.")
        make_agent, config = self._agent()
        env = ReachVectorEnv(self._task(config), 1)
        episodes = evaluation_episodes(env.scene, env.config, self.episodes, self.seed)
        agent = make_agent()
        if self.video is None and self.strip is None:

            def announce(number: int) -> None:
                target, colour = env.facets[int(env.facet_ids[0])]
                print(f"Episode {number + 1} of {len(episodes)}: {colour} {target}", flush=True)

            print("Ctrl-C ends it.", flush=True)
            watch(
                agent,
                env,
                episodes,
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
        if self.agent in SCRIPTED_AGENTS:
            return lambda: SCRIPTED_AGENTS[self.agent].make(self.seed), EnvConfig(
                robot=self.robot or "irb120"
            )
        if "/" not in self.agent and not Path(self.agent).exists():
            raise unknown_name("agent or run folder", self.agent, SCRIPTED_AGENTS)
        trained = load_agent(self.agent, seed=self.seed)
        if self.robot is not None and find_robot(self.robot) != find_robot(
            trained.config.env.robot
        ):
            raise UserError(
                f"The run {self.agent} was trained on robot {trained.config.env.robot!r}, not on "
                f"{self.robot!r}: leave the robot out."
            )
        return lambda: trained.agent, trained.config.env

    def _task(self, config: EnvConfig) -> EnvConfig:
        return replace(
            config,
            targets=self.targets or config.targets,
            colours=self.colours or config.colours,
            dynamics=self.dynamics or config.dynamics,
        )


COMMAND = View
