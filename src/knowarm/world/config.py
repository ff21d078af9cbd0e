"""Configuration of the reaching task."""

from dataclasses import dataclass, field
from typing import Literal

from knowarm.config import check_numbers
from knowarm.errors import UserError
from knowarm.world.held_out import HeldOut
from knowarm.world.robots import DEFAULT_ROBOT
from knowarm.world.visual_randomization import VisualRandomization

MAX_IMAGE_SIZE = 4096


@dataclass(frozen=True, kw_only=True)
class EnvConfig:
    """The reaching task (paper, section 3). Defaults are the paper's training settings."""

    robot: str = DEFAULT_ROBOT
    """A name in ``ROBOTS`` or ``KNOWN_ARMS``, or the TOML file of your own robot."""

    targets: tuple[str, ...] = ("mug", "bottle", "cereal_box")
    """Names in ``TARGETS`` or TOML files; one is drawn uniformly per episode."""

    colours: Literal["fixed", "randomized"] = "fixed"
    """Always a target's first colour, or one of its colours drawn per episode."""

    dynamics: Literal["dynamic", "kinematic"] = "dynamic"
    """Servos, inertia and contacts, or joint angles set exactly."""

    max_episode_steps: int = 50
    """Steps after which an episode is truncated."""

    success_distance_m: float = 0.05
    """Distance from gripper to grasp point below which a target counts as reached [m]."""

    success_angle_deg: float = 15.0
    """Angle between gripper and grasp frame below which a target counts as reached [deg]."""

    ignore_roll: bool = False
    """Ignore the rotation about the approach axis in the angle."""

    mpi_rad: float | None = None
    """Maximum position increment (MPI), the largest joint step of an action [rad] (slides: [m]);
    None takes the robot's own."""

    image_size: int = 64
    """Width and height of the image [px]."""

    renderer: Literal["raycast", "opengl"] = "raycast"
    """KnowArm's ray caster, or MuJoCo's OpenGL renderer as the (slow) reference."""

    antialiasing: bool = True
    """Average several rays in pixels that contain an edge (ray caster only)."""

    mesh_detail: Literal["pixels", "full"] = "pixels"
    """Meshes of a robot simplified to what the image's pixels can show, or with all their
    triangles as the (slow) reference (ray caster only)."""

    randomization: VisualRandomization = field(default_factory=VisualRandomization)
    """What varies in the image besides the paper's colours; all off by default."""

    held_out: HeldOut | None = None
    """Colours and places reserved for a test of generalization; None reserves none."""

    def __post_init__(self) -> None:
        check_numbers(self)
        _one_of("colours", self.colours, ("fixed", "randomized"))
        _one_of("dynamics", self.dynamics, ("dynamic", "kinematic"))
        _one_of("renderer", self.renderer, ("raycast", "opengl"))
        _one_of("mesh_detail", self.mesh_detail, ("pixels", "full"))
        for name in ("success_distance_m", "success_angle_deg", "mpi_rad"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise UserError(f"EnvConfig.{name} must be greater than 0, got {value}.")
        if self.max_episode_steps < 1:
            raise UserError(
                f"EnvConfig.max_episode_steps must be at least 1, got {self.max_episode_steps}."
            )
        if not 1 <= self.image_size <= MAX_IMAGE_SIZE:
            raise UserError(
                f"EnvConfig.image_size must be 1 to {MAX_IMAGE_SIZE}, got {self.image_size}."
            )
        if not self.targets:
            raise UserError("EnvConfig.targets is empty; name at least one target.")
        if len(set(self.targets)) != len(self.targets):
            raise UserError(
                f"EnvConfig.targets contains a name twice: {', '.join(self.targets)}; list each "
                "once."
            )


def _one_of(field: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise UserError(f"EnvConfig.{field} must be one of {', '.join(allowed)}, got {value!r}.")
