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
from knowarm.world.objects import TARGETS
from knowarm.world.robot_check import MJCF_SUFFIXES, Check, check_robot
from knowarm.world.scene import load_scene
from knowarm.world.scene_image import write_scene_image


@dataclass(frozen=True, kw_only=True)
class Doctor:
    """Check this installation, or a robot of your own with its target objects."""

    robot: Annotated[str | None, tyro.conf.arg(metavar="ROBOT", help_behavior_hint="")] = None
    """Robot to check instead of the installation: a name, TOML description or MJCF file."""
    targets: tuple[str, ...] = tuple(TARGETS)
    """Objects the robot should reach, by name or TOML file."""
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
        if self.robot is None:
            self._refuse("a robot", set=self.set, write=self.write, image=self.image)
            checks, what = check_installation(self.runs), "installation"
        else:
            checks, what = self._check_robot(self.robot), f"robot {self.robot}"
        rows = [["ok" if c.ok else "FAILED", c.name, c.found] for c in checks]
        print_table(f"Checks of the {what}", ["result", "check", "found"], rows)
        write_json_table(self.json, {"what": what, "checks": [vars(check) for check in checks]})
        failed = [check for check in checks if not check.ok]
        if failed:
            remedies = " ".join(f"{check.name}: {check.remedy}" for check in failed)
            raise UserError(f"{len(failed)} of {len(checks)} checks failed. {remedies}")

    def _check_robot(self, robot: str) -> list[Check]:
        """Check a description, after drafting it where the robot is a bare MJCF file."""
        if not robot.endswith(MJCF_SUFFIXES):
            self._refuse("an MJCF file", set=self.set, write=self.write)
            self._draw(robot)
            return check_robot(robot, self.targets)
        if self.write is not None and (self.write.suffix != SUFFIX or self.write.exists()):
            raise UserError(
                f"--write must name a {SUFFIX} file that does not exist, got {str(self.write)!r}."
            )
        draft = draft_robot(Path(robot), self.targets, read_overrides(self.set))
        rows = [[topic, text] for topic, text in draft.how.items()]
        print_table(f"Draft of a description of {robot}", ["topic", "choice"], rows)
        print(draft.toml(self.write))
        if task := draft.task_options():
            print(f"The arm can do the task with an easier orientation; train it with {task}\n")
        with TemporaryDirectory() as folder:
            file = self.write or Path(folder) / f"{Path(robot).stem}{SUFFIX}"
            file.write_text(draft.toml(file))
            self._draw(str(file))
            return check_robot(
                file,
                self.targets,
                angle_deg=draft.success_angle_deg,
                ignore_roll=draft.ignore_roll,
            )

    def _draw(self, robot: str) -> None:
        """Write the image if one is wanted."""
        if self.image is not None:
            config = EnvConfig(robot=robot, targets=self.targets)
            write_scene_image(load_scene(robot, self.targets), config, self.image)
            print(f"Wrote {self.image}")

    def _refuse(self, needed: str, **options: object) -> None:
        """Refuse options that need ``--robot`` to be something else.

        Raises:
            UserError: one of them was given.
        """
        for name, value in options.items():
            if value:
                raise UserError(f"--{name} needs --robot with {needed}.")
