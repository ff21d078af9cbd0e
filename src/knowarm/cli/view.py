"""``knowarm view``: films of an agent: in the browser, as a video, as a strip, or for Rerun."""

import webbrowser
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self, cast

from tyro.conf import Positional, arg

from knowarm.cli.arguments import parse_options, take_option
from knowarm.cli.evaluate import is_scripted
from knowarm.cli.tables import FilePath
from knowarm.errors import UserError, shell_command
from knowarm.pictures import check_suffix
from knowarm.world.agents import SCRIPTED_AGENTS, AgentProtocol
from knowarm.world.config import EnvConfig
from knowarm.world.envs.episodes import evaluation_episodes
from knowarm.world.envs.vector_env import ArmVectorEnv
from knowarm.world.robots import DEFAULT_ROBOT, find_robot
from knowarm.world.tasks import find_task
from knowarm.world.tasks.task import Task
from knowarm.world.viewing.dataset import is_dataset, write_dataset_page
from knowarm.world.viewing.record import (
    check_page,
    check_video,
    record_episode,
    write_page,
    write_strip,
    write_video,
)
from knowarm.world.viewing.rerun import check_rrd, write_rrd

PAGE = Path("knowarm-view.html")
"""Page that is written where no file is named, in the working directory: browsers that are
installed as snaps cannot read the folder of temporary files."""


@dataclass(frozen=True, kw_only=True)
class View:
    """Show films of an agent, or a recorded dataset, in the browser, or write them to files."""

    robot: Annotated[str | None, Positional, arg(metavar="[ROBOT]")] = None
    """Robot (see `knowarm list`) or TOML file of a robot of your own; a run has its own. Or the
    folder of a recorded dataset."""
    agent: Annotated[str, arg(metavar="AGENT")] = "oracle"
    """A scripted agent (see `knowarm list`), or a run folder."""
    episodes: int = 6
    """Number of episodes."""
    seed: int = 0
    """Seed of the episodes, and of the actions of a stochastic agent."""
    task: Task = field(default_factory=lambda: EnvConfig().task)
    """Task of a scripted agent, by name or as package.module:Name; a run has its own."""
    targets: tuple[str, ...] = ()
    """Objects to reach, by name or TOML file. Default: all, or the run's."""
    colours: Literal["fixed", "randomized"] | None = None
    """Colours of the objects. Default: fixed, or the run's."""
    dynamics: Literal["dynamic", "kinematic"] | None = None
    """Motion of the arm: simulated servos, or exact positions. Default: dynamic, or the run's."""
    angle_deg: float | None = None
    """Largest angle at which the target counts as reached [deg]. Default: 15, or the run's."""
    ignore_roll: bool = False
    """Ignore the rotation about the approach axis in this angle."""
    page: FilePath = None
    """Write an .html page with a film per episode: the policy's images beside a large view.
    Without any file to write: knowarm-view.html, which is replaced."""
    browser: bool = True
    """Open the page in the browser."""
    video: FilePath = None
    """Write an .mp4 video of these films."""
    strip: FilePath = None
    """Write an image with one film strip per episode."""
    rrd: FilePath = None
    """Write images, joints, distances and what a run knows to an .rrd file for Rerun's viewer."""
    axes: bool = False
    """Draw the frames of grasp and gripper, and the sphere of success around the grasp, over the
    large view."""

    @classmethod
    def parse(cls, prog: str, arguments: Sequence[str]) -> Self:
        """Make a command from its options; `--task` takes the name of a task."""
        words, task = take_option(arguments, "--task", "choose")
        default = cls() if task is None else cls(task=find_task(task))
        return parse_options(cls, prog, words, default=default)

    def run(self) -> None:
        """Play the episodes and show or record them."""
        page = self.page
        if not any((page, self.video, self.strip, self.rrd)):
            page = PAGE
        if page is not None:
            check_page(page)
        if self.robot is not None and is_dataset(self.robot):
            self._show_dataset(Path(self.robot), page)
            return
        if self.strip is not None:
            check_suffix(self.strip, "A film strip")
        if self.video is not None:
            check_video(self.video)
        if self.rrd is not None:
            check_rrd(self.rrd)
        make_agent, config = self._agent()
        options = {
            "targets": self.targets,
            "colours": self.colours,
            "dynamics": self.dynamics,
            "ignore_roll": self.ignore_roll,
            "success_angle_deg": self.angle_deg,
        }
        changes: dict[str, Any] = {
            name: value for name, value in options.items() if value
        }
        env = ArmVectorEnv(replace(config, **changes), 1)
        episodes = evaluation_episodes(env.config, self.episodes, self.seed)
        agent = make_agent(env)
        films = []
        knowledge = []
        for number in range(self.episodes):
            episode = episodes[number : number + 1]
            film = record_episode(agent, env, episode, axes=self.axes)
            films.append(film)
            if self.rrd is not None:
                knowledge.append(self._knowledge(agent, film[0].policy))
        reached = sum(film[-1].success for film in films)
        print(f"{reached} of {len(films)} episodes reached their target.")
        scene = env.scene
        if self.video is not None:
            write_video(self.video, films)
            print(f"Wrote {self.video}")
        if self.strip is not None:
            write_strip(self.strip, films)
            print(f"Wrote {self.strip}")
        if self.rrd is not None:
            write_rrd(self.rrd, films, scene.joint_names, knowledge)
            print(f"Wrote {self.rrd}")
        if page is not None:
            write_page(page, f"KnowArm: {scene.robot.name}, {self.agent}", films)
            self._show(page)

    def _show(self, page: Path) -> None:
        print(f"Wrote {page}")
        if self.browser:
            webbrowser.open(page.resolve().as_uri())

    def _show_dataset(self, folder: Path, page: Path | None) -> None:
        """Show the first episodes of a recorded dataset."""
        shown = View(
            robot=self.robot,
            episodes=self.episodes,
            page=self.page,
            browser=self.browser,
        )
        if page is None or self != shown:
            raise UserError(
                "A dataset is shown as a page as it was recorded: give --page, --episodes and "
                "--browser alone."
            )
        count = write_dataset_page(folder, page, self.episodes)
        print(f"{count} episodes of {folder}.")
        self._show(page)

    def _knowledge(self, agent: AgentProtocol, image: Any) -> dict[str, Any]:
        """Return what the agent knows in the episode that it has played."""
        if is_scripted(self.agent):
            return {}
        from knowarm.perception.recognition import known_in_episode  # imports torch
        from knowarm.perception.solving import SeeingAgent

        if isinstance(agent, SeeingAgent):
            agent = agent.agent
        return known_in_episode(cast(Any, agent), image)

    def _agent(self) -> tuple[Callable[[ArmVectorEnv], AgentProtocol], EnvConfig]:
        """Return a constructor of the agent, and its environment's config."""
        if is_scripted(self.agent):
            robot = self.robot or DEFAULT_ROBOT
            if (Path(robot) / "config.json").exists():
                raise UserError(
                    f"{robot} is a run: {shell_command('view', '--agent', robot)}"
                )
            config = EnvConfig(robot=robot, task=self.task)
            return lambda env: SCRIPTED_AGENTS[self.agent].make(env, self.seed), config
        # Imports torch, which takes seconds.
        from knowarm.experiment.evaluate import check_fits
        from knowarm.experiment.load import load_agent

        trained = load_agent(self.agent, seed=self.seed)
        config = trained.config.env
        if self.robot is not None and find_robot(self.robot) != find_robot(
            config.robot
        ):
            robots = f"robot {config.robot!r}, not on {self.robot!r}"
            raise UserError(
                f"The run {self.agent} was trained on {robots}: leave out the robot."
            )

        def make(env: ArmVectorEnv) -> AgentProtocol:
            check_fits(trained, env, knows_task=False)
            return trained.player

        return make, config
