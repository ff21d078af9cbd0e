"""``knowarm doctor``: checks of this installation or a robot, and drafts of descriptions."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import tyro

from knowarm.cli.tables import FilePath, TableCommand, print_table
from knowarm.errors import UserError
from knowarm.pictures import check_suffix
from knowarm.reading import replacing
from knowarm.world.config import EnvConfig
from knowarm.world.description import SUFFIX
from knowarm.world.own_robot.camera_check import check_camera
from knowarm.world.own_robot.draft import draft_robot, read_overrides
from knowarm.world.own_robot.object_check import check_objects
from knowarm.world.own_robot.robot_check import MJCF_SUFFIXES, Check, check_robot
from knowarm.world.own_robot.scene_image import write_scene_image
from knowarm.world.robots import DEFAULT_ROBOT
from knowarm.world.scene.scene import load_scene


@dataclass(frozen=True, kw_only=True)
class Doctor(TableCommand):
    """Check this installation, or a robot of your own with its target objects."""

    robot: Annotated[str | None, tyro.conf.arg(metavar="ROBOT", help_behavior_hint="")] = None
    """Robot to check instead of the installation: a name, TOML description or MJCF file."""
    targets: tuple[str, ...] = ()
    """Objects the robot should reach, by name or TOML file. Default: those of the task."""
    task: str | None = None
    """Check the objects of a task such as "choose": whether this robot reaches them where the task
    places them, and whether any two of them, and any two colours, differ in the image."""
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="FIELD=VALUE")] = ()
    """Fields of the description that are given instead of drafted, in TOML's notation, such as
    'home=[0.0, 1.5]' (MJCF file only)."""
    angle_deg: float = EnvConfig.success_angle_deg
    """Largest angle between gripper and grasp frame in the checks of a robot [deg]."""
    ignore_roll: bool = False
    """Ignore the rotation about the approach axis in the checks of a robot."""
    write: FilePath = None
    """Write the drafted description to this TOML file (MJCF file only)."""
    image: FilePath = None
    """Draw the robot at its start, with the rectangle of the targets, to this PNG file."""
    camera: FilePath = None
    """Compare a photograph of the robot at its start with the simulated view, drawn to --image."""
    points: FilePath = None
    """CSV file with the columns point, x and y: pixels of known points in the photograph."""
    runs: Path = Path("runs")
    """Output folder of training runs, checked for free disk space."""

    def run(self) -> Mapping[str, Any]:
        """Run the checks, print and write them; failed ones end in a `UserError`."""
        if self.camera is None:
            self._refuse("--camera", "points")
        values = super().run()
        if failed := [check for check in values["checks"] if not check["ok"]]:
            shared: dict[str, list[str]] = {}
            for check in failed:
                shared.setdefault(check["remedy"], []).append(check["name"])
            remedies = " ".join(f"{', '.join(names)}: {r}" for r, names in shared.items())
            raise UserError(f"{len(failed)} of {len(values['checks'])} checks failed. {remedies}")
        return values

    def result(self) -> dict[str, Any]:
        """Run the checks and print them."""
        if self.image is not None:
            check_suffix(self.image, "The image")
        if self.camera is not None:
            self._refuse("no --camera", "set", "write", "task", "targets")
            config = EnvConfig(robot=self.robot or DEFAULT_ROBOT)
            overlay = self.image or Path("camera.png")
            checks = check_camera(config, self.camera, self.points, overlay)
            what = f"camera of robot {config.robot}"
        elif self.task is not None:
            self._refuse("no --task", "set", "write", "image")
            robot = self.robot or DEFAULT_ROBOT
            options = {"success_angle_deg": self.angle_deg, "ignore_roll": self.ignore_roll}
            checks = check_objects(robot, self.task, self.targets, **options)
            what = f"objects of robot {robot}"
        elif self.robot is None:
            from knowarm.experiment.installation_check import check_installation  # imports torch

            self._refuse("--robot", "set", "write", "image", "targets")
            checks, what = check_installation(self.runs), "installation"
        else:
            targets = self.targets or EnvConfig().targets
            checks, what = self._check_robot(self.robot, targets), f"robot {self.robot}"
        rows = [["ok" if c.ok else "FAILED", c.name, c.found] for c in checks]
        print_table(f"Checks of the {what}", ["result", "check", "found"], rows)
        return {"what": what, "checks": [vars(check) for check in checks]}

    def _check_robot(self, robot: str, targets: tuple[str, ...]) -> list[Check]:
        """Check a description, after drafting it where the robot is a bare MJCF file."""
        if not robot.endswith(MJCF_SUFFIXES):
            self._refuse("--robot with an MJCF file", "set", "write")
            self._draw(robot, targets)
            return check_robot(
                robot, targets, angle_deg=self.angle_deg, ignore_roll=self.ignore_roll
            )
        if (new := self.write) is not None and (new.suffix != SUFFIX or new.exists()):
            raise UserError(f"--write must name a {SUFFIX} file that does not exist, got {new}.")
        draft = draft_robot(Path(robot), targets, read_overrides(self.set))
        title = f"Draft of a description of {robot}"
        print_table(title, ["topic", "choice"], list(draft.how.items()))
        print(draft.toml(self.write))
        if task := draft.task_options():
            name, bare = Path(robot).stem, task.replace("env.success-", "").replace("env.", "")
            file, agent = self.write or f"{name}{SUFFIX}", "full-fast"
            print(
                "The arm can do the task with an easier orientation, which every command needs:\n"
                f"  knowarm doctor --robot {file} {bare}\n"
                f"  knowarm view {file} {bare}\n"
                f"  knowarm evaluate oracle --env.robot {file} {task.replace('env.success-', '')}\n"
                f"  knowarm train {agent} --env.robot {file} {task}\n"
                f"  knowarm evaluate runs/{Path(file).stem}-{agent}/0 "
                f"{bare.removesuffix('--ignore-roll').strip()}\n"
            )
        with TemporaryDirectory() as folder:
            file = self.write or Path(folder) / f"{Path(robot).stem}{SUFFIX}"
            with replacing(file) as temporary:
                temporary.write_text(draft.toml(file), "utf-8")
            self._draw(str(file), targets)
            angle, roll = draft.success_angle_deg, draft.ignore_roll
            return check_robot(file, targets, angle_deg=angle, ignore_roll=roll)

    def _draw(self, robot: str, targets: tuple[str, ...]) -> None:
        """Write the image if one is wanted."""
        if self.image is not None:
            config = EnvConfig(robot=robot, targets=tuple(targets))
            write_scene_image(load_scene(robot, targets), config, self.image)
            print(f"Wrote {self.image}")

    def _refuse(self, needed: str, *options: str) -> None:
        """Refuse options that need another command line."""
        for name in options:
            if getattr(self, name):
                raise UserError(f"--{name} needs {needed}.")
