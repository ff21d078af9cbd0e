"""Robot description: model file, joints, gripper, and the scene around the robot."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from knowarm.config import check_values
from knowarm.errors import UserError
from knowarm.questions import object_of


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table with four legs on which the targets stand."""

    half_size_m: tuple[float, float]
    """Half extent of the top along x and y [m]."""
    centre_m: tuple[float, float]
    """Centre of the top in the robot's base frame, x and y [m]."""
    height_m: float
    """Height of the upper surface above the floor [m]."""

    def __post_init__(self) -> None:
        if min(self.half_size_m) <= 0 or self.height_m <= 0:
            raise UserError(
                f"Table.half_size_m and height_m must be positive, got {self.half_size_m} and "
                f"{self.height_m}."
            )


@dataclass(frozen=True, kw_only=True)
class Area:
    """What differs from the robot's own fields in the tasks of an area; None: nothing."""

    centre_m: tuple[float, float] | None = None
    """Centre of the rectangle of target positions, x and y [m]."""
    half_size_m: tuple[float, float] | None = None
    """Half extent of that rectangle along x and y [m]."""
    home: tuple[float, ...] | None = None
    """Start angle of each joint [rad] (slides: [m])."""
    mpi_rad: float | None = None
    """Maximum position increment [rad] (slides: [m])."""
    target_yaw_deg: float | None = None
    """Yaw of the targets [deg]; those of ``target_yaws_deg`` have their own."""
    target_yaws_deg: Mapping[str, float] = field(default_factory=dict)
    """Yaw of single targets by name [deg]."""


FINGERS_JOINT = "fingers"
"""Name of the two fingers, which move alike, as one joint."""

_AREA_FIELDS = {
    "rectangle_centre_m": "centre_m",
    "rectangle_half_size_m": "half_size_m",
    "home": "home",
    "mpi_rad": "mpi_rad",
    "target_yaw_deg": "target_yaw_deg",
}
"""Fields of a `Robot` that an `Area` can replace, and the area's names of them."""


@dataclass(frozen=True, kw_only=True)
class RealJoint:
    """A joint as the real arm counts it: value = sign * scale * angle in its unit + offset."""

    name: str = ""
    """Name on the real arm; empty: that of the model."""
    sign: Literal[1, -1] = 1
    """-1 where the real arm counts the other way."""
    offset: float = 0.0
    """What the real arm reads, in its unit, where the model's angle is 0 (ranges: is added)."""
    scale: float = 1.0
    """What the real arm counts per unit, such as for a gear that its maker leaves out."""
    range: tuple[float, float] | None = None
    """Angles of the model at which the unit's range begins and ends [rad] (slides: [m]), as the
    unit at hand was calibrated; None: the limits of the joint."""
    unit: Literal["rad", "deg", "range_0_1", "range_0_100", "range_m100_100"] = "rad"
    """Radians (slides: metres), degrees, 0 to 1 over ``range``, or LeRobot's ranges over it."""

    def __post_init__(self) -> None:
        if self.scale <= 0:
            raise UserError(
                f"RealJoint.scale must be positive, got {self.scale}; sign = -1 turns a joint."
            )
        if self.range is None:
            return
        low, high = self.range
        if low >= high or not self.unit.startswith("range"):
            raise UserError(
                "RealJoint.range is of the units range_0_1, range_0_100 and range_m100_100, with "
                f"the lower end first; got {low} to {high} of the unit {self.unit!r}."
            )


@dataclass(frozen=True, kw_only=True)
class Robot:
    """A fixed-base arm: its model file, the joints that the agent moves, and the scene around it.

    Frames: the robot's base is the world origin, x forward, z up. Lengths in metres, angles in
    radians unless the name says degrees. Joints of the model that are not named in ``joints`` are
    fixed at the value in ``held_joints`` or at their reference.
    """

    name: str
    """Name by which users select the robot."""
    title: str = ""
    """Name in reports, with the maker's; ``name`` if empty."""
    gym_name: str = ""
    """Its part of the Gymnasium ids of a shipped robot, as in ``knowarm/IRB120Reach-v0``."""
    mjcf: Path
    """MJCF file of the robot. Its actuators, keyframes and cameras are ignored."""
    joints: tuple[str, ...]
    """Names of the joints that the agent moves, base to tip: hinges, or slides with a range."""
    tcp_site: str
    """Site at the tool centre point: z is the approach direction, y the finger opening."""
    tcp_body: str | None = None
    """Body to which ``tcp_site`` is added; None if the model has the site."""
    tcp_position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Position of the added site in the frame of ``tcp_body`` [m]."""
    tcp_quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Orientation of the added site in the frame of ``tcp_body``, wxyz."""
    home: tuple[float, ...]
    """Start angle of each joint [rad] (slides: [m])."""
    mpi_rad: float = 0.10
    """Maximum position increment (MPI): the largest joint step of an action [rad] (slides: [m])."""
    start_fraction: float = 0.15
    """Half-width of the start distribution relative to half the joint's range (paper, table 1).

    The paper draws U(f * lower, f * upper). The interval home +- f * (upper - lower) / 2 used here
    is the same where home is f * (lower + upper) / 2, as it is for both shipped robots.
    """
    start_joints: tuple[int, ...] = (0, 1)
    """Indices of the joints that start at a random offset from home (paper: joints 1 and 2)."""
    joint_ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Ranges of single joints where the file's are not the arm's [rad] (slides: [m])."""
    held_joints: Mapping[str, float] = field(default_factory=dict)
    """Values at which joints outside ``joints`` are fixed [rad or m]."""
    fingers: tuple[str, ...] = ()
    """Names of the two fingers in the model, bodies or geoms, drawn open; empty for none. They
    move only in tasks that need it."""
    finger_shares: tuple[float, float] = (0.5, 0.5)
    """Share of the gap between the fingers that each crosses as they close; (1, 0): a jaw that
    closes on one that stays."""
    cannot_hold: Mapping[str, str] = field(default_factory=dict)
    """Objects that these fingers cannot hold at their grasp frame, with the reason."""
    base_position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Position of the model's origin, world [m]."""
    base_yaw_deg: float = 0.0
    """Rotation of the model about the vertical through its origin, so that it faces x [deg]."""
    table: Table | None = None
    """Table on which the targets stand; None for the floor."""
    rectangle_centre_m: tuple[float, float]
    """Centre of the rectangle of target positions, x and y [m]."""
    rectangle_half_size_m: tuple[float, float]
    """Half extent of that rectangle along x and y [m]."""
    areas: Mapping[str, Area] = field(default_factory=dict)
    """Other rectangles of target positions, by the name of the tasks' area, such as "choose"."""
    target_yaw_deg: float
    """Direction of the targets' x axis (their grasp side) about the vertical [deg]."""
    target_yaws_deg: Mapping[str, float] = field(default_factory=dict)
    """Yaw of single targets by name, if different from ``target_yaw_deg`` [deg]."""
    grasp_turns_deg: Mapping[str, float] = field(default_factory=dict)
    """Turn of the grasp frame of single targets about their approach direction [deg], and of those
    with a ``round_grasp`` under the name "round". A gripper with two fingers grasps equally after
    half a turn, and round things after any; the wrist's range may not allow all."""
    trays_m: tuple[tuple[float, float], ...] = ()
    """Centres of the trays on which things are placed, x and y [m]; empty without any."""
    camera_position_m: tuple[float, float, float]
    """Position of the fixed camera [m]."""
    camera_look_at_m: tuple[float, float, float]
    """Point at the centre of the image [m]."""
    camera_fovy_deg: float
    """Vertical field of view [deg]."""
    camera_roll_deg: float = 0.0
    """Turn of the camera about its optical axis, from level: positive turns its right side down
    [deg]."""
    camera_intrinsics: tuple[float, float, float, float] | None = None
    """Of the real camera: focal lengths along x and y and the principal point from the upper left
    corner, x and y, all in heights of its images; None: the field of view is
    ``camera_fovy_deg``, and the principal point is the centre."""
    camera_distortion: tuple[float, ...] = ()
    """Of the real camera's lens: OpenCV's k1, k2, p1, p2, k3; empty: none. The simulated image has
    none: images of the real camera are rectified."""
    success_distance_m: float | None = None
    """Distance below which a target counts as reached in training [m]; None: 5 cm."""
    success_angle_deg: float | None = None
    """Angle below which it does [deg]; None: 15. Evaluations take it where it is above 17."""
    ignore_roll: bool = False
    """Whether the rotation about the approach axis is ignored, as for arms of few joints."""
    evaluation_distance_m: float | None = None
    """Largest distance of a success in evaluations [m]; None: 10 cm."""
    servo_frequency_hz: float = 7.0
    """Natural frequency of the critically damped position servos [Hz]."""

    joint_map: Mapping[str, RealJoint] = field(default_factory=dict)
    """Joints of the real arm by the model's name, in the real arm's order; empty: the model's.
    The value at which another joint is held, such as an open gripper's, is sent in each step.
    "fingers" are those that some tasks move: 0 where they are open, metres of each finger."""

    def __post_init__(self) -> None:
        check_values(self)
        if not self.title:
            object.__setattr__(self, "title", self.name)
        for is_valid, message in self._requirements():
            if not is_valid:
                raise UserError(f"Robot {self.name!r}: {message}.")
        for name in self.areas:
            try:
                self.for_area(name)
            except UserError as error:
                raise UserError(f"areas.{name}: {error}") from error

    def _requirements(self) -> Iterator[tuple[bool, str]]:
        """Yield what the fields must fulfil: whether they do, and the message if not."""
        joints = self.joints
        count = len(joints)
        yield count > 0, "joints is empty; name at least one hinge or slide joint"
        yield len(set(joints)) == count, f"joints {joints} must be different names"
        yield (
            len(self.home) == count,
            f"home has {len(self.home)} values for {count} joints",
        )
        yield (
            all(0 <= index < count for index in self.start_joints),
            f"start_joints {self.start_joints} must be indices 0 to {count - 1} into joints",
        )
        shares = self.finger_shares
        yield (
            0 < shares[0] <= sum(shares) == 1,
            f"finger_shares must add up to 1, the first above 0; got {shares}",
        )
        for name, (low, high) in self.joint_ranges.items():
            yield (
                low < high,
                f"joint_ranges.{name} is {low} to {high}; give the lower first",
            )
        if self.joint_map:
            yield (
                set(joints) <= set(self.joint_map),
                f"joint_map must name every joint of joints; got {', '.join(self.joint_map)}",
            )
        real = [joint.name or name for name, joint in self.joint_map.items()]
        yield (
            len(set(real)) == len(real),
            f"joint_map has a name twice: {', '.join(real)}",
        )
        lens = self.camera_distortion
        has_focus = self.camera_intrinsics is not None
        yield (
            len(lens) in (0, 4, 5) and (has_focus or not lens),
            f"camera_distortion must be k1, k2, p1, p2, k3, beside camera_intrinsics; got {lens}",
        )
        if self.camera_intrinsics is not None:
            focus = self.camera_intrinsics[:2]
            yield (
                min(focus) > 0,
                f"camera_intrinsics must begin with focal lengths, got {focus}",
            )

    def for_area(self, name: str) -> "Robot":
        """Return the robot as it is in an area; unchanged if it has none of the name."""
        if name not in self.areas:
            return self
        area = self.areas[name]
        changes: dict[str, Any] = {"areas": {}}
        for field_name, area_field in _AREA_FIELDS.items():
            value = getattr(area, area_field)
            if value is not None:
                changes[field_name] = value
        yaws = dict(area.target_yaws_deg)
        # The area's yaw of all targets also replaces the robot's yaws of single ones.
        if area.target_yaw_deg is None:
            yaws = {**self.target_yaws_deg, **yaws}
        return replace(self, target_yaws_deg=yaws, **changes)

    @property
    def support_height_m(self) -> float:
        """Height of the surface on which the targets stand [m]."""
        return self.table.height_m if self.table else 0.0

    def yaw_deg(self, target: str) -> float:
        """Return the yaw of the target of a name [deg]; parts have that of their object."""
        return self.target_yaws_deg.get(object_of(target), self.target_yaw_deg)
