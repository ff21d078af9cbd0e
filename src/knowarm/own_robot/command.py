"""``knowarm doctor``: checks of this installation or a robot, and drafts of descriptions."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import tyro

from knowarm.check import Check
from knowarm.cli.tables import FilePath, TableCommand, print_table
from knowarm.errors import UserError, printable
from knowarm.own_robot.camera_check import check_camera
from knowarm.own_robot.draft import Draft, draft_robot, read_overrides, shrink_distance
from knowarm.own_robot.object_check import check_objects
from knowarm.own_robot.robot_check import EVALUATION_M, check_robot
from knowarm.own_robot.scene_image import write_scene_image
from knowarm.own_robot.urdf import MODEL_SUFFIXES, as_mjcf
from knowarm.pictures import check_suffix
from knowarm.reading import replacing
from knowarm.world.config import EnvConfig
from knowarm.world.description import SUFFIX
from knowarm.world.robots import DEFAULT_ROBOT
from knowarm.world.scene.scene import load_scene

DRAFT_OPTIONS = ("set", "write", "xacro", "package")
"""Options of the draft of a description from a bare model file."""


@dataclass(frozen=True, kw_only=True)
class Doctor(TableCommand):
    """Check this installation, or a robot of your own with its target objects."""

    robot: Annotated[str | None, tyro.conf.arg(metavar="ROBOT")] = None
    """Robot to check instead of the installation: a name, TOML description, or MJCF, URDF
    or xacro file."""
    targets: tuple[str, ...] = ()
    """Objects the robot should reach, by name or TOML file. Default: those of the task."""
    task: str | None = None
    """Check the objects of a task such as "choose": whether this robot reaches them where the task
    places them, and whether any two of them, and any two colours, differ in the image."""
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="FIELD=VALUE")] = ()
    """Fields of the description that are given instead of drafted, in TOML's notation, such as
    'home=[0.0, 1.5]' (model file only)."""
    xacro: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME:=VALUE")] = ()
    """Arguments of a xacro file, such as dof:=6."""
    package: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=FOLDER")] = ()
    """Folders of ROS packages that a URDF or xacro file names and that lie neither above nor beside
    it."""
    angle_deg: float = EnvConfig.success_angle_deg
    """Largest angle between gripper and grasp frame in the checks of a robot [deg]."""
    ignore_roll: bool = False
    """Ignore the rotation about the approach axis in the checks of a robot."""
    distance_m: float = EVALUATION_M
    """Distance of success in an evaluation with which the check of a fixed list judges [m]."""
    write: FilePath = None
    """Write the drafted description to this TOML file (model file only); a converted URDF goes
    into a folder of the same name."""
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
            self._refuse("no --camera", *DRAFT_OPTIONS, "task", "targets")
            config = EnvConfig(robot=self.robot or DEFAULT_ROBOT)
            overlay = self.image or Path("camera.png")
            found: Iterable[Check] = check_camera(config, self.camera, self.points, overlay)
            what = f"camera of robot {config.robot}"
        elif self.task is not None:
            robot = self.robot or DEFAULT_ROBOT
            found = self._check_robot(robot, self.targets)
            what = f"objects of robot {robot}"
        elif self.robot is None:
            from knowarm.experiment.installation_check import check_installation  # imports torch

            self._refuse("--robot", *DRAFT_OPTIONS, "image", "targets")
            found, what = check_installation(self.runs), "installation"
        else:
            found, what = self._check_robot(self.robot, self.targets), f"robot {self.robot}"
        checks = list[Check]()
        for check in found:
            if not checks:  # a robot's draft is printed before
                print(f"Checks of the {what}; what runs for the first time is compiled:")
            checks.append(check)
            line = f"{'ok' if check.ok else 'FAILED':<6}  {check.name}: {check.found}"
            print(printable(line), flush=True)
        return {"what": what, "checks": [vars(check) for check in checks]}

    def _check_robot(self, robot: str, targets: tuple[str, ...]) -> Iterator[Check]:
        """Check a description, after drafting it where the robot is a bare model file."""
        names = ("angle_deg", "ignore_roll", "distance_m")
        options: dict[str, Any] = {name: getattr(self, name) for name in names}
        if not robot.endswith(MODEL_SUFFIXES):
            self._refuse("--robot with an MJCF, URDF or xacro file", *DRAFT_OPTIONS)
            yield from self._check(robot, targets, **options)
            return
        if (new := self.write) is not None and (new.suffix != SUFFIX or new.exists()):
            raise UserError(f"--write must name a {SUFFIX} file that does not exist, got {new}.")
        with TemporaryDirectory() as folder:
            file = self.write or Path(folder) / f"{Path(robot).with_suffix('').stem}{SUFFIX}"
            model, note = as_mjcf(
                Path(robot), file.with_suffix(""), arguments=self.xacro, packages=self.package
            )
            drawn = targets or EnvConfig().targets
            draft = draft_robot(model, drawn, read_overrides(self.set))
            if self.task is None:
                draft = shrink_distance(draft, drawn)
            if note:
                draft.how["file"] = note + ("" if self.write else "; --write keeps the result")
            self._print(draft, file)
            with replacing(file) as temporary:
                temporary.write_text(draft.toml(file), "utf-8")
            options = {"angle_deg": draft.success_angle_deg, "ignore_roll": draft.ignore_roll}
            yield from self._check(str(file), targets, **options, distance_m=draft.distance_m)

    def _check(
        self, robot: str, targets: tuple[str, ...], distance_m: float, **options: Any
    ) -> Iterable[Check]:
        """Draw and check a robot's description, or the objects of a task."""
        self._draw(robot, targets or EnvConfig().targets)
        if self.task is None:
            targets = targets or EnvConfig().targets
            return check_robot(robot, targets, **options, distance_m=distance_m)
        options["success_angle_deg"] = options.pop("angle_deg")
        return check_objects(robot, self.task, targets, **options)

    def _print(self, draft: Draft, file: Path) -> None:
        """Print a draft, and the commands that come next."""
        title = f"Draft of a description of {self.robot}"
        print_table(title, ["topic", "choice"], list(draft.how.items()))
        print(draft.toml(file))
        file, agent = self.write or Path(file.name), "full-fast"
        eased = draft.success_angle_deg != EnvConfig.success_angle_deg
        angle = f"--angle-deg {draft.success_angle_deg:.0f}" if eased else ""
        roll, judged = "ignore-roll" if draft.ignore_roll else "", draft.evaluation_options()
        lines = (
            f"doctor --robot {file} {judged} {roll and f'--{roll}'}",
            f"view {file} {angle} {roll and f'--{roll}'}",
            f"evaluate oracle --env.robot {file} {judged} {roll and f'--env.{roll}'}",
            f"train {agent} --env.robot {file} {draft.task_options()}",
            f"evaluate runs/{file.stem}-{agent}/0 {judged}",
        )
        print("Next, each with the options that this arm needs:")
        print("".join(f"  knowarm {' '.join(line.split())}\n" for line in lines))

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
