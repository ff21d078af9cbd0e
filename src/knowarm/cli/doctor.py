"""``knowarm doctor``: checks of this installation or a robot, and drafts of descriptions."""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import tyro

from knowarm.cli.tables import FilePath, check_json_path, print_table, write_json_table
from knowarm.errors import UserError
from knowarm.experiment.installation_check import check_installation
from knowarm.world.config import EnvConfig
from knowarm.world.description_file import SUFFIX
from knowarm.world.draft import draft_robot, read_overrides
from knowarm.world.object_check import check_objects
from knowarm.world.objects import CHOICE_TARGETS
from knowarm.world.robot_check import MJCF_SUFFIXES, Check, check_robot
from knowarm.world.robots import DEFAULT_ROBOT
from knowarm.world.scene import load_scene
from knowarm.world.scene_image import write_scene_image


@dataclass(frozen=True, kw_only=True)
class Doctor:
    """Check this installation, or a robot of your own with its target objects."""

    robot: Annotated[str | None, tyro.conf.arg(metavar="ROBOT", help_behavior_hint="")] = None
    """Robot to check instead of the installation: a name, TOML description or MJCF file."""
    targets: tuple[str, ...] = ()
    """Objects the robot should reach, by name or TOML file. Default: those of the task."""
    choose: bool = False
    """Check the objects of the choice task: whether this robot reaches them where several stand,
    and whether any two of them, and any two colours, can be told apart in the image."""
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="FIELD=VALUE")] = ()
    """Fields of the description that are given instead of drafted, in TOML's notation, such as
    'home=[0.0, 1.5]' (MJCF file only)."""
    write: FilePath = None
    """Write the drafted description to this TOML file (MJCF file only)."""
    image: FilePath = None
    """Draw the robot at its start, with the rectangle of the targets, to this PNG file."""
    runs: Path = Path("runs")
    """Output folder of training runs, checked for free disk space."""
    json: FilePath = None
    """Also write the checks to this JSON file."""

    def run(self) -> None:
        """Run the checks and print them.

        Raises:
            UserError: at least one check failed.
        """
        check_json_path(self.json)
        if self.choose:
            self._refuse("no --choose", set=self.set, write=self.write, image=self.image)
            robot = self.robot or DEFAULT_ROBOT
            targets = self.targets or CHOICE_TARGETS
            checks, what = check_objects(robot, targets), f"objects of robot {robot}"
        elif self.robot is None:
            self._refuse("--robot", set=self.set, write=self.write, image=self.image)
            checks, what = check_installation(self.runs), "installation"
        else:
            targets = self.targets or EnvConfig().targets
            checks, what = self._check_robot(self.robot, targets), f"robot {self.robot}"
        rows = [["ok" if c.ok else "FAILED", c.name, c.found] for c in checks]
        print_table(f"Checks of the {what}", ["result", "check", "found"], rows)
        write_json_table(self.json, {"what": what, "checks": [vars(check) for check in checks]})
        failed = [check for check in checks if not check.ok]
        if failed:
            remedies = " ".join(f"{check.name}: {check.remedy}" for check in failed)
            raise UserError(f"{len(failed)} of {len(checks)} checks failed. {remedies}")

    def _check_robot(self, robot: str, targets: tuple[str, ...]) -> list[Check]:
        """Check a description, after drafting it where the robot is a bare MJCF file."""
        if not robot.endswith(MJCF_SUFFIXES):
            self._refuse("--robot with an MJCF file", set=self.set, write=self.write)
            self._draw(robot, targets)
            return check_robot(robot, targets)
        if self.write is not None and (self.write.suffix != SUFFIX or self.write.exists()):
            raise UserError(
                f"--write must name a {SUFFIX} file that does not exist, got {str(self.write)!r}."
            )
        draft = draft_robot(Path(robot), targets, read_overrides(self.set))
        rows = [[topic, text] for topic, text in draft.how.items()]
        print_table(f"Draft of a description of {robot}", ["topic", "choice"], rows)
        print(draft.toml(self.write))
        if task := draft.task_options():
            print(f"The arm can do the task with an easier orientation; train it with {task}\n")
        with TemporaryDirectory() as folder:
            file = self.write or Path(folder) / f"{Path(robot).stem}{SUFFIX}"
            file.write_text(draft.toml(file))
            self._draw(str(file), targets)
            return check_robot(
                file,
                targets,
                angle_deg=draft.success_angle_deg,
                ignore_roll=draft.ignore_roll,
            )

    def _draw(self, robot: str, targets: tuple[str, ...]) -> None:
        """Write the image if one is wanted."""
        if self.image is not None:
            config = EnvConfig(robot=robot, targets=tuple(targets))
            write_scene_image(load_scene(robot, targets), config, self.image)
            print(f"Wrote {self.image}")

    def _refuse(self, needed: str, **options: object) -> None:
        """Refuse options that need another command line.

        Raises:
            UserError: one of them was given.
        """
        for name, value in options.items():
            if value:
                raise UserError(f"--{name} needs {needed}.")
