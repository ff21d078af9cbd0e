"""An MJCF file and facts go in; a ``Robot`` that a scene can be built from comes out."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from knowarm.errors import UserError


@dataclass(frozen=True, kw_only=True)
class Table:
    """A table the targets stand on, with four legs down to the floor."""

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
class Robot:
    """A fixed-base arm: its model file, the joints the agent moves, and the scene around it.

    Frames: the robot's base is the world origin, x forward, z up. Lengths in metres, angles in
    radians unless the name says degrees. Joints of the model that are not named in ``joints`` are
    held still, at the value in ``held_joints`` or at their reference.
    """

    name: str
    """The name users type."""

    mjcf: Path
    """MJCF file of the robot. Its own actuators, keyframes and cameras are left out."""

    joints: tuple[str, ...]
    """Names of the joints the agent moves, base to tip: hinges or slides with a range."""

    tcp_site: str
    """Site at the tool centre point: z is the approach direction, y the finger opening."""

    tcp_body: str | None = None
    """Body to put ``tcp_site`` on when the model has no such site; None: the model has it."""

    tcp_position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Position of the added site in the frame of ``tcp_body`` [m]."""

    tcp_quaternion: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Orientation of the added site in the frame of ``tcp_body``, wxyz."""

    home: tuple[float, ...]
    """Start angle of each joint [rad] (slides: [m])."""

    start_fraction: float = 0.15
    """Half width of the start draw, as a share of half the joint's range (paper, table 1).

    The paper draws U(f * lower, f * upper). Written about home, home +- f * (upper - lower) / 2 is
    that same interval wherever home is its middle, as it is for both shipped robots.
    """

    start_joints: tuple[int, ...] = (0, 1)
    """Indices of the joints that start at a random offset from home (paper: joints 1 and 2)."""

    held_joints: Mapping[str, float] = field(default_factory=dict)
    """Value at which a joint outside ``joints`` is held [rad or m]."""

    base_position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where the model's origin is put in the world [m]."""

    table: Table | None = None
    """The table the targets stand on; None: they stand on the floor."""

    rectangle_centre_m: tuple[float, float]
    """Centre of the rectangle in which targets are placed, x and y [m]."""

    rectangle_half_size_m: tuple[float, float]
    """Half extent of that rectangle along x and y [m]."""

    target_yaw_deg: float
    """Direction of the targets' x axis (the side that is grasped) about the vertical [deg]."""

    target_yaws_deg: Mapping[str, float] = field(default_factory=dict)
    """Yaw of single targets by name, where it differs from ``target_yaw_deg`` [deg]."""

    camera_position_m: tuple[float, float, float]
    """Position of the fixed camera [m]."""

    camera_look_at_m: tuple[float, float, float]
    """Point in the middle of the image [m]."""

    camera_fovy_deg: float
    """Vertical field of view [deg]."""

    servo_frequency_hz: float = 7.0
    """Natural frequency of the critically damped position servos [Hz]."""

    def __post_init__(self) -> None:
        where = f"Robot {self.name!r}"
        if not self.joints:
            raise UserError(f"{where}: joints is empty; name at least one hinge or slide joint.")
        if len(set(self.joints)) != len(self.joints):
            raise UserError(f"{where}: joints holds a name twice: {', '.join(self.joints)}.")
        if len(self.home) != len(self.joints):
            raise UserError(
                f"{where}: home has {len(self.home)} values for {len(self.joints)} joints; give "
                "one start angle a joint."
            )
        if not all(0 <= j < len(self.joints) for j in self.start_joints):
            raise UserError(
                f"{where}: start_joints {self.start_joints} must be indices 0 to "
                f"{len(self.joints) - 1} into joints."
            )
        if not 0 <= self.start_fraction <= 1:
            raise UserError(
                f"{where}: start_fraction must lie in 0 to 1, got {self.start_fraction}."
            )
        if min(self.rectangle_half_size_m) < 0:
            raise UserError(
                f"{where}: rectangle_half_size_m must not be negative, got "
                f"{self.rectangle_half_size_m}."
            )
        if not 0 < self.camera_fovy_deg < 180:
            raise UserError(
                f"{where}: camera_fovy_deg must lie between 0 and 180, got {self.camera_fovy_deg}."
            )
        if self.servo_frequency_hz <= 0:
            raise UserError(
                f"{where}: servo_frequency_hz must be positive, got {self.servo_frequency_hz}."
            )

    @property
    def support_height_m(self) -> float:
        """Height of the surface the targets stand on [m]."""
        return self.table.height_m if self.table else 0.0

    def yaw_deg(self, target: str) -> float:
        """Yaw at which a target of this name stands [deg]."""
        return self.target_yaws_deg.get(target, self.target_yaw_deg)
