"""Driver: plays a runner on a robot, with safety rules before anything is sent; needs no ROS.

`Driver.tick` returns the joint targets to send, or None. A *hold* sends nothing until its reason is
gone; an *end* is final. A step out of the workspace, or away from a blocked arm, is shortened.
Two clocks: stamps are compared with the clock that made them; periods and holds are measured by a
monotonic one, which no time server sets.
"""

import io
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from knowarm.arrays import Floats, Mask
from knowarm.config import check_values
from knowarm.deploy.runner import Runner, Start
from knowarm.deploy.watch import ImageWatch, SourceWatch
from knowarm.errors import UserError
from knowarm.pictures import central_square
from knowarm.reading import one_line

Targets = Floats
Pixels = NDArray[np.uint8]
EARLIEST = 0.8  # Shortest time between two targets, in control periods
SHARES = (1.0, 0.5, 0.25)  # Shares of a step that are tried
JUMP = 2.0  # Fastest motion of a joint that is believed, in MPI per control period
ENCODINGS = {"rgb8": "RGB", "bgr8": "BGR", "rgba8": "RGBX", "bgra8": "BGRX"}
"""Encodings of ROS that are read, and Pillow's names of a pixel's bytes; alpha is left out."""


@dataclass(frozen=True, kw_only=True)
class Safety:
    """Rules that hold before a joint target is sent, beside limits, speed and workspace."""

    max_age_s: float = 0.3
    """Age of image or joint angles from which nothing moves [s]."""
    patience_s: float = 5.0
    """Length of a hold after which the episode ends [s]."""
    wait_s: float = 60.0
    """The same before the first step: robot and camera start [s]."""
    following_steps: float = 4.0
    """Largest distance of a target from the angle, in MPI; fingers stop at what they hold."""
    gripper_step_m: float | None = None
    """Largest step of each finger per control period [m]; None: the MPI."""
    confirm_steps: int = 5
    """First steps that a person confirms one by one."""
    max_steps: int | None = None
    """Length of the episode; None: that of the training."""
    dry_run: bool = False
    """Print the steps and send nothing."""

    def __post_init__(self) -> None:
        check_values(self)


@dataclass(frozen=True, kw_only=True)
class Topics:
    """Names of the ROS topics."""

    image: str = "/camera/image_raw"
    """sensor_msgs/Image: rgb8, bgr8, rgba8 or bgra8."""
    compressed: bool = False
    """Images are sensor_msgs/CompressedImage: JPEG or PNG."""
    joint_states: str = "/joint_states"
    """sensor_msgs/JointState, matched by name."""
    trajectory: str = "/joint_trajectory_controller/joint_trajectory"
    """trajectory_msgs/JointTrajectory."""
    positions: str = ""
    """Instead of trajectories, std_msgs/Float64MultiArray to it."""
    gripper: str = ""
    """The gripper's own controller, with messages of the same type; empty: that of the arm."""
    stop: str = "/knowarm/stop"
    """std_msgs/Empty; any message ends the episode, and so does a publisher of another type."""
    use_clock: bool = False
    """Take the time from /clock, as simulators publish it."""


class Driver:
    """Plays one episode of a runner on a robot.

    ``gripper`` computes the gripper's position (3,) [m], robot base, at joint angles (J,);
    ``knowledge`` is a row of the table; ``resize`` averages the central square of larger images.

    Rules hold for the policy's joint angles [rad]; the real arm's units are converted where
    readings come in and targets go out, in the order of ``joint_names``, of which
    ``model_joints`` are the model's names.

    Attributes: ``status``, one line for the person beside the robot; ``end``, why the episode ended
    (empty while it runs); ``completed``, whether all steps were played; ``steps``, their number;
    ``clock``, which returns seconds that never run backwards.
    """

    def __init__(
        self,
        runner: Runner,
        gripper: Callable[[Targets], Targets],
        safety: Safety,
        knowledge: str | None = None,
        *,
        resize: bool = False,
    ) -> None:
        contract = runner.contract
        self._runner = runner
        self._gripper = gripper
        self.safety = safety
        self._knowledge = knowledge
        self._resize = resize
        self._map = runner.joint_map
        self.joint_names = self._map.names
        self.model_joints = self._map.joints
        self._names = runner.joint_names
        self.period_s = float(contract["control_period_s"])
        self._mpi = float(contract["joints"]["mpi"])
        count = len(self._names)
        fingers = runner.fingers
        self._largest_step = np.full(count, np.inf)
        self._largest_lag = np.full(count, safety.following_steps * self._mpi)
        if fingers is not None:
            self._largest_lag[fingers] = np.inf
            self._largest_step[fingers] = safety.gripper_step_m or np.inf
        elif safety.gripper_step_m is not None:
            remedy = "leave gripper_step_m out"
            raise UserError(f"The policy moves no gripper: {remedy}.")
        self.max_steps = safety.max_steps or int(contract["max_episode_steps"])
        box = contract["workspace_m"]
        self._box = np.array([box["lower"], box["upper"]])
        self.status = "waiting"
        self.end = ""
        self.completed = False
        self.steps = 0
        # Each with its stamp, or the reason why there is none.
        self._inputs: dict[str, Any] = {
            "image": "not yet seen",
            "joint angles": "not yet seen",
        }
        self._before: dict[str, Any] = {}  # the runner's state before the proposal
        self._proposal: Targets | None = None
        self._is_confirmed = False
        self.clock: Callable[[], float] = time.monotonic
        self._ticked_at: float | None = None
        self._proposed_at = -np.inf
        self._sent_at = -np.inf
        self._sent = np.zeros(count)
        self._held_since = np.inf
        self._felt: tuple[Targets, float] | None = None  # last angles and their stamp
        self._images = ImageWatch(self._mpi)
        # A second source ends the episode before it is forgotten.
        self._sources = SourceWatch(self.joint_names, 2 * safety.patience_s)
        rows = contract["knowledge"]["rows"]
        is_needed = knowledge is not None or len(rows) > 1
        if is_needed and knowledge not in rows:
            raise UserError(
                f"The knowledge must be a row such as {rows[0]!r}, got {knowledge!r}."
            )
        runner.is_started = False

    def see(self, image: Pixels | str, stamp_s: float) -> None:
        """Take an image (H, W, 3) RGB, taken at ``stamp_s``, or the reason why there is none."""
        self._inputs["image"] = self._judged(image, stamp_s)

    def _judged(self, image: Pixels | str, stamp_s: float) -> Any:
        """Return an image with its stamp, or the reason why it is not taken."""
        if isinstance(image, str):
            return image
        runner = self._runner
        if self._resize:
            image = shrunk(image, runner.contract["camera"])
        if runner.lens is not None:
            problem = runner.lens.problem(image[None])
            if problem:
                return f"is refused: {problem}"
        elif image.shape != runner.image_shape or image.dtype != np.uint8:
            return f"is {image.shape} instead of {runner.image_shape}; resize it"
        if image.min() == image.max():
            return "shows a single colour"
        return image, stamp_s

    def feel(
        self,
        names: Sequence[str],
        positions: Sequence[float],
        stamp_s: float,
        source: str = "",
    ) -> None:
        """Take what the real arm reads by name, measured at ``stamp_s``; others are ignored.

        ``source`` tells the programs apart that send readings: two of one joint hold.
        """
        self._sources.tell(names, source, self.clock())
        measured = names[: len(positions)]
        if not set(measured).isdisjoint(self._map.moved):  # else of another robot
            self._inputs["joint angles"] = self._measured(names, positions, stamp_s)

    def _measured(
        self, names: Sequence[str], positions: Sequence[float], stamp_s: float
    ) -> Any:
        """Return joint angles with their stamp, or the reason why they are not taken."""
        for name in self.joint_names:
            if list(names).count(name) > 1:
                return f"name {name} twice in one message"
        if len(positions) > len(names):
            return "are more numbers than names"
        readings = dict(zip(names, positions, strict=False))
        values = [readings.get(name, np.nan) for name in self.joint_names]
        angles = self._map.from_real(values)
        is_unknown = ~np.isfinite(angles)
        if is_unknown.any():
            return f"lack a number for {_named(self._map.moved, is_unknown)}"
        before, before_s = self._felt or (angles, stamp_s)
        self._felt = (angles, stamp_s)
        most = JUMP * self._mpi * max(1.0, abs(stamp_s - before_s) / self.period_s)
        if (abs(angles - before) > most).any():
            return "jump; does another robot publish these joints?"
        return self._felt

    def confirm(self) -> None:
        """Confirm the step that ``status`` shows; without effect where there is none."""
        self._is_confirmed = self._proposal is not None and self._held_since == np.inf

    def stop(self, reason: str) -> None:
        """End the episode."""
        self.end = self.end or reason or "stopped"
        self.status = self.end

    def tick(self, now_s: float, obstacle: str = "") -> Targets | None:
        """Return what to send the real arm now, (R,), or None; once per control period.

        ``now_s`` is the time by the clock of the stamps, ``obstacle`` a reason to hold.
        """
        steady = self.clock()
        longest = self.safety.patience_s if self.steps else self.safety.wait_s
        before = self._ticked_at
        self._ticked_at = steady
        if before is not None and not 0 <= steady - before <= longest:
            self.stop(
                f"stopped: {steady - before:.1f} s passed between two control periods"
            )
        if self.end or steady - self._sent_at < EARLIEST * self.period_s:
            return None
        is_old = steady - self._proposed_at > self.safety.patience_s
        if self._proposal is not None and is_old:
            # What is confirmed must be what is seen now.
            vars(self._runner).update(self._before)
            self._proposal = None
        problem = obstacle or self._input_problem(now_s, steady)
        if not problem:
            angles = self._seen("joint angles")
            try:
                if self._proposal is None:
                    self._proposal = self._propose(self._seen("image"), angles)
                    self._proposed_at = steady
                self._check(self._proposal)
            except ValueError as error:
                self.stop(f"stopped: {error}")
                return None
            for share in SHARES:
                targets = self._previous + share * (self._proposal - self._previous)
                problem = self._barred(targets, angles)
                if not problem:
                    return None if self.end else self._released(targets, steady)
            self._runner.targets = self._previous[None]
            self._proposal = None
        self.status = f"hold: {problem}"
        self._held_since = min(self._held_since, steady)
        if steady - self._held_since > longest:
            self.stop(f"stopped after {longest:g} s: {problem}")
        return None

    def _propose(self, image: Pixels, angles: Targets) -> Targets:
        """Compute the next targets."""
        runner = self._runner
        if not runner.is_started:
            joints = dict(zip(self._names, angles.tolist(), strict=True))
            runner.reset(Start(joints, self._knowledge))
            self._sent = runner.targets[0]
        if self.safety.dry_run:  # nothing follows the targets: steps start at the arm
            runner.targets = angles.clip(runner.lower, runner.upper)[None]
            self._sent = runner.targets[0]
        self._previous = runner.targets[0].copy()
        self._is_confirmed = False
        self._before = dict(vars(runner))
        runner.act({"image": image[None]})
        return runner.targets[0]

    def _released(self, targets: Targets, steady: float) -> Targets | None:
        """Return checked targets if the step needs no confirmation or has it."""
        self._held_since = np.inf
        is_dry = self.safety.dry_run
        # Slow fingers follow in later steps what the policy wants once.
        least = self._sent - self._largest_step
        most = self._sent + self._largest_step
        sent = targets.clip(least, most)
        moves = zip(self._names, sent - self._sent, strict=True)
        change = ", ".join(f"{name} {move:+.3f}" for name, move in moves)
        if self._runner.fingers is not None:
            closed = self._runner.closed(sent)
            change += f", gripper {closed:.0%} closed"
        self.status = f"step {self.steps + 1} of {self.max_steps}: {change}"
        is_free = is_dry or self.steps >= self.safety.confirm_steps
        if not is_free and not self._is_confirmed:
            self.status += "; Enter moves, anything else stops"
            return None
        self.status = f"dry run, {self.status}" if is_dry else "moving"
        self._runner.targets = targets[None].copy()
        self._proposal = None
        if not is_dry:
            self._images.commanded(targets)
        self._sent = sent
        self._sent_at = steady
        self.steps += 1
        if self.steps == self.max_steps:
            self.completed = True
            self.stop(f"all {self.max_steps} steps are played")
        return None if is_dry else self._map.to_real(sent)

    def _input_problem(self, now_s: float, steady: float) -> str:
        """Say which input is missing, wrong, old, from the future or in doubt.

        In doubt are joint angles of two programs, and images that do not change.
        """
        most = self.safety.max_age_s
        for name, content in self._inputs.items():
            if isinstance(content, str):
                return f"{name} {content}"
            _, stamp_s = content
            if not stamp_s:
                return f"{name} without a time stamp"
            age = now_s - stamp_s
            if not abs(age) <= most:
                when = "in the future; synchronize the clocks" if age < 0 else "old"
                return f"{name} more than {most:g} s {when}"
        problem = self._sources.problem(steady)
        if problem:
            return f"joint angles {problem}"
        return self._images.problem(self._seen("image"), self._seen("joint angles"))

    def _seen(self, name: str) -> Any:
        """Return an input without its stamp."""
        value, _ = self._inputs[name]
        return value

    def _check(self, targets: Targets) -> None:
        """Raise `ValueError` for targets (J,) that no intact policy computes."""
        most = self._mpi * (1 + 1e-6)
        is_beyond = (targets < self._runner.lower) | (targets > self._runner.upper)
        is_fast = abs(targets - self._previous) > most
        for is_broken, text in (
            (~np.isfinite(targets), "the target is not finite"),
            (is_beyond, "the target is beyond its limit"),
            (is_fast, f"faster than {most / self.period_s:g} / s"),
        ):
            if is_broken.any():
                raise ValueError(f"{_named(self._names, is_broken)}: {text}")

    def _barred(self, targets: Targets, angles: Targets) -> str:
        """Say what is in the way of targets, for measured joint angles; both (J,)."""
        is_far = abs(targets - angles) > self._largest_lag
        if is_far.any():
            return f"{_named(self._names, is_far)}: blocked, or moved by hand"
        position = self._gripper(targets)
        if (position == position.clip(*self._box)).all():
            return ""
        place = position.round(2).tolist()
        return f"the gripper would leave the workspace, to {place} m"


def _named(names: Sequence[str], is_meant: Mask) -> str:
    """List the names of joints that a mask selects."""
    return ", ".join(np.array(names)[is_meant])


def shrunk(image: NDArray[Any], camera: Mapping[str, Any]) -> NDArray[Any]:
    """Average the central square of an RGB image (H, W, 3) to a policy's; smaller ones stay.

    So do those of a contract's ``camera`` with intrinsics, which the runner rectifies.
    """
    size = camera["size"]
    is_rgb = image.shape[2:] == (3,) and image.dtype == np.uint8
    is_small = min(image.shape[:2]) < size or image.shape[:2] == (size, size)
    if not is_rgb or is_small or "intrinsics" in camera:
        return image
    return np.asarray(central_square(Image.fromarray(image), size))


def decoded(
    encoding: str, height: int, width: int, step: int, data: bytes
) -> Pixels | str:
    """Return the pixels (H, W, 3) RGB of a ROS image, or the reason why it cannot be read."""
    if encoding not in ENCODINGS:
        why = "is not"
        if "mono" in encoding:
            why = "is grey, and the policy sees colours; publish"
        return f"of the encoding {encoding!r} {why} {', '.join(ENCODINGS)}"
    pixel = ENCODINGS[encoding]
    if not 0 < len(pixel) * width <= step or not 0 < len(data) == height * step:
        return f"has {len(data)} bytes, which are not {height} rows of {step}"
    size = (width, height)
    return np.array(Image.frombytes("RGB", size, data, "raw", pixel, step))


def decompressed(data: bytes) -> Pixels | str:
    """Return the pixels (H, W, 3) RGB of a JPEG or PNG file, or why it cannot be read."""
    try:
        with Image.open(io.BytesIO(data), formats=("JPEG", "PNG")) as image:
            if image.mode not in ("RGB", "RGBA"):
                return f"of the mode {image.mode!r} is not RGB; publish colours"
            return np.array(image.convert("RGB"))
    except UnidentifiedImageError:  # its text names an object in memory
        return "is no JPEG or PNG"
    except Exception as error:  # Pillow raises many types
        return f"is no JPEG or PNG: {one_line(error)}"
