"""``knowarm doctor``: checks of this installation or a robot, and drafts of descriptions."""

import re
import shlex
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import tyro

from knowarm.check import Check
from knowarm.cli.tables import FilePath, TableCommand, print_table
from knowarm.errors import UserError, printable, shell_command
from knowarm.own_robot.calibration import (
    Unit,
    joint_map_toml,
    lerobot_map,
    motor_names,
    narrower_ranges,
    read_calibration,
    unit_map,
)
from knowarm.own_robot.camera_check import check_camera
from knowarm.own_robot.draft import Draft, draft_robot, read_overrides, shrink_distance
from knowarm.own_robot.moved_joints import check_moved_joints
from knowarm.own_robot.object_check import check_objects
from knowarm.own_robot.plausible import ranges_of
from knowarm.own_robot.repair import repair_draft
from knowarm.own_robot.robot_check import check_robot
from knowarm.own_robot.scene_image import write_scene_image
from knowarm.own_robot.urdf import MODEL_SUFFIXES, as_mjcf, keep_converted
from knowarm.pictures import check_suffix
from knowarm.reading import write_text
from knowarm.world.config import EnvConfig
from knowarm.world.description import SUFFIX
from knowarm.world.robots import DEFAULT_ROBOT, find_robot
from knowarm.world.robots.robot import Robot
from knowarm.world.scene.mjcf import read_mjcf
from knowarm.world.scene.scene import load_scene

UNITS: tuple[Unit, ...] = ("rad", "deg")
LEROBOT_UNITS: tuple[Unit, ...] = ("range", "deg")
"""Units of all joints, and those in which LeRobot counts calibrated ones; the first by default."""

DRAFT_OPTIONS = ("set", "write", "xacro", "package")
"""Options of the draft of a description from a bare model file."""

OTHER_OPTIONS = (*DRAFT_OPTIONS, "task", "targets", "calibration", "unit")
"""Those that do not go with checks of a real camera or of joints that were moved."""


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
    angle_deg: float | None = None
    """Largest angle between gripper and grasp frame in the checks of a robot [deg]. Default: its
    description's, else 15."""
    ignore_roll: bool = False
    """Ignore the rotation about the approach axis in the checks of a robot."""
    distance_m: float | None = None
    """Distance of success in an evaluation with which the check of a fixed list judges [m].
    Default: its description's, else .10."""
    write: FilePath = None
    """Write the drafted description to this TOML file (model file only); a converted URDF goes
    into a folder of the same name."""
    image: FilePath = None
    """Draw the robot at its start, with the rectangle of the targets, to this PNG file."""
    camera: FilePath = None
    """Compare a photograph of the robot at its start with the simulated view, drawn to --image."""
    points: FilePath = None
    """CSV file with the columns point, x and y: pixels of known points in the photograph."""
    calibration: FilePath = None
    """LeRobot's calibration file of an arm, from which its joint_map is made; --write names the
    TOML file that gets it. Default: none, the drafted joint_map counts in --unit."""
    unit: Unit | None = None
    """Unit of the real arm's joints in that map: rad, deg, or range for LeRobot's -100 to 100.
    Default: range with --calibration, else rad."""
    joints: FilePath = None
    """CSV file of joints that were told to move by five degrees, with the columns joint, before,
    after and unit: what the arm itself read."""
    runs: Path = Path("runs")
    """Output folder of training runs, checked for free disk space."""

    def run(self) -> Mapping[str, Any]:
        """Run the checks, print and write them; failed ones end in a `UserError`."""
        if self.camera is None:
            self._refuse("--camera", "points")
        values = super().run()
        failed = [check for check in values["checks"] if not check["ok"]]
        if failed:
            names_of: dict[str, list[str]] = {}
            for check in failed:
                names_of.setdefault(check["remedy"], []).append(check["name"])
            text = f"{len(failed)} of {len(values['checks'])} checks failed."
            for remedy, names in names_of.items():
                text += f" {', '.join(names)}: {remedy}"
            raise UserError(text)
        return values

    def result(self) -> dict[str, Any]:
        """Run the checks and print them."""
        if self.image is not None:
            check_suffix(self.image, "The image")
        what, results = self._checks()
        checks = list[Check]()
        for check in results:
            if not checks:  # a robot's draft is printed before
                print(
                    f"Checks of the {what}; what runs for the first time is compiled:"
                )
            checks.append(check)
            verdict = "ok" if check.ok else "FAILED"
            print(printable(f"{verdict:<6}  {check.name}: {check.found}"), flush=True)
        return {"what": what, "checks": [vars(check) for check in checks]}

    def _checks(self) -> tuple[str, Iterable[Check]]:
        """Return what is checked, and the checks."""
        robot = self.robot or DEFAULT_ROBOT
        if self.robot is None:
            self._refuse("--robot", "calibration", "unit", "joints")
        if self.camera is not None:
            self._refuse("no --camera", *OTHER_OPTIONS, "joints")
            config = EnvConfig(robot=robot)
            overlay = self.image or Path("camera.png")
            checks = check_camera(config, self.camera, self.points, overlay)
            return f"camera of robot {config.robot}", checks
        if self.joints is not None:
            self._refuse("no --joints", *OTHER_OPTIONS, "image")
            return f"joints of robot {robot}", check_moved_joints(robot, self.joints)
        if self.task is not None:
            return f"objects of robot {robot}", self._check_robot(robot)
        if self.robot is not None:
            return f"robot {robot}", self._check_robot(robot)
        # Imports torch
        from knowarm.experiment.installation_check import (
            check_installation,
        )

        self._refuse("--robot", *DRAFT_OPTIONS, "image", "targets")
        return "installation", check_installation(self.runs)

    def _check_robot(self, robot: str) -> Iterator[Check]:
        """Check a description, after drafting it where the robot is a bare model file."""
        new = self.write
        maps = self.calibration is not None or self.unit is not None
        unit = self._unit()
        if not robot.lower().endswith(MODEL_SUFFIXES):
            options = [name for name in DRAFT_OPTIONS if name != "write" or not maps]
            self._refuse("--robot with an MJCF, URDF or xacro file", *options)
            if maps:
                self._write_map(find_robot(robot))
            yield from self._check(robot)
            return
        self._refuse_existing()
        with TemporaryDirectory() as scratch:
            stem = _run_name(Path(robot).with_suffix("").stem)
            file = new or Path(scratch) / f"{stem}{SUFFIX}"
            folder = file.with_suffix("")
            model, note = as_mjcf(
                Path(robot),
                Path(scratch) / folder.name,
                arguments=self.xacro,
                packages=self.package,
            )
            is_kept = new is not None and bool(note)
            if is_kept and folder.exists():
                raise UserError(
                    f"The folder {folder} for the converted model exists; remove or rename it."
                )
            targets = self.targets or EnvConfig().targets
            given = read_overrides(self.set)
            if self.calibration is not None:
                ranges = given.get("joint_ranges", {})
                given["joint_map"], narrower = self._calibrated(model, ranges, {})
                if narrower:
                    given["joint_ranges"] = narrower | ranges
            draft = draft_robot(model, targets, given)
            if maps and self.calibration is None:
                joints = draft.robot.joints
                draft.fields["joint_map"] = unit_map(joints, unit)
            if self.task is None:
                draft = repair_draft(draft, targets, given)
                draft = shrink_distance(draft, targets)
            if note:
                draft.how["file"] = note if new else f"{note}; --write keeps the result"
            if is_kept:  # only now, so that a draft that is stopped leaves nothing
                keep_converted(model, folder)
                robot_there = replace(draft.robot, mjcf=folder / model.name)
                draft = replace(draft, robot=robot_there)
            text = draft.toml(file)
            self._print(draft, text, new or Path(file.name))
            write_text(file, text)
            yield from self._check(str(file))

    def _check(self, robot: str) -> Iterable[Check]:
        """Draw and check a robot's description, or the objects of a task."""
        targets = self.targets or EnvConfig().targets
        if self.image is not None:
            config = EnvConfig(robot=robot, targets=targets)
            write_scene_image(load_scene(robot, targets), config, self.image)
            print(f"Wrote {self.image}")
        if self.task is None:
            return check_robot(
                robot,
                targets,
                angle_deg=self.angle_deg,
                ignore_roll=self.ignore_roll,
                distance_m=self.distance_m,
            )
        return check_objects(
            robot,
            self.task,
            self.targets,
            success_angle_deg=self.angle_deg or 0.0,
            ignore_roll=self.ignore_roll,
        )

    def _write_map(self, robot: Robot) -> None:
        """Print the joint map of a description's real arm, or write it to a TOML file."""
        if self.calibration is None:
            entries = unit_map(robot.joints, self._unit())
        else:
            names = motor_names(robot.joint_map)
            ranges = robot.joint_ranges
            entries, narrower = self._calibrated(robot.mjcf, ranges, names)
            if narrower:
                fields = ", ".join(
                    f"{name} = {ends}" for name, ends in narrower.items()
                )
                print(
                    "The arm turns less far than the model. Add to the description, and train "
                    f"with it: joint_ranges = {{{fields}}}"
                )
        text = joint_map_toml(entries)
        if self.write is None:
            print(text)
            return
        self._refuse_existing()
        write_text(self.write, text)
        use = shlex.join(["--joint-map", str(self.write)])
        print(
            f"Wrote {self.write}; knowarm serve, ros, record and export take it: {use}"
        )

    def _refuse_existing(self) -> None:
        """Refuse to write to another file than a new TOML file."""
        new = self.write
        if new is not None and (new.suffix != SUFFIX or new.exists()):
            raise UserError(
                f"--write must name a {SUFFIX} file that does not exist, got {new}."
            )
        if new is not None and new.stem != _run_name(new.stem):
            raise UserError(
                f"--write must name a file of letters, digits, '-', '_', '+' and '.', as runs are "
                f"named after it, got {new}. Take {new.with_stem(_run_name(new.stem))}."
            )

    def _unit(self) -> Unit:
        """Return the unit that is given, or the usual one."""
        allowed = UNITS if self.calibration is None else LEROBOT_UNITS
        unit = self.unit or allowed[0]
        if unit not in allowed:
            raise UserError(
                f"--unit must be {' or '.join(allowed)} here, got {unit}. The unit range needs "
                "--calibration, and LeRobot counts in no radians."
            )
        return unit

    def _calibrated(
        self, mjcf: Path, given: Mapping[str, Any], names: Mapping[str, str]
    ) -> tuple[dict[str, Any], dict[str, list[float]]]:
        """Return the joint map that a calibration gives a model, and what it turns less far."""
        assert self.calibration is not None
        model = read_mjcf(mjcf, str(mjcf)).compile()
        motors = read_calibration(self.calibration)
        ranges = ranges_of(model, given)
        narrower = narrower_ranges(motors, ranges, names)
        return lerobot_map(motors, ranges, names, self._unit()), narrower

    def _print(self, draft: Draft, text: str, file: Path) -> None:
        """Print a draft, and the commands that come next."""
        title = f"Draft of a description of {self.robot}"
        print_table(title, ["topic", "choice"], list(draft.how.items()))
        print(text)
        targets = self._options("targets")
        trained = self._options("targets", prefix="env.")
        agent = "full-fast"
        print("Next:")
        commands = [
            ("doctor", "--robot", file, *targets),
            ("view", file, *targets),
            ("evaluate", "oracle", "--env.robot", file, *trained),
            ("train", agent, "--env.robot", file, *trained),
            ("evaluate", f"runs/{file.stem}-{agent}/0"),
        ]
        if self.write is None:  # the others read the file
            options = self._options("targets", *DRAFT_OPTIONS, "calibration", "unit")
            commands[0] = ("doctor", "--robot", self.robot, *options, "--write", file)
        for words in commands:
            print(f"  {shell_command(*words)}")
        print()

    def _options(self, *names: str, prefix: str = "") -> list[Any]:
        """Return options that are given, as words of a command line."""
        words: list[Any] = []
        for name in names:
            value = getattr(self, name)
            if value:
                words.append(f"--{prefix}{name}")
                words += value if isinstance(value, tuple) else [value]
        return words

    def _refuse(self, needed: str, *options: str) -> None:
        """Refuse options that need another command line."""
        for name in options:
            if getattr(self, name):
                raise UserError(f"--{name} needs {needed}.")


def _run_name(stem: str) -> str:
    """Return the name of a file as one that a run can have."""
    return re.sub(r"^[.+-]|[^\w.+-]+", "_", stem, flags=re.ASCII)
