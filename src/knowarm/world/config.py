"""What a user sets about the task goes in, checked; every part of the world reads it."""

from dataclasses import dataclass, field
from typing import Literal

from knowarm.errors import UserError
from knowarm.world.held_out import HeldOut
from knowarm.world.visual_randomization import VisualRandomization

MAX_IMAGE_SIZE = 4096


@dataclass(frozen=True, kw_only=True)
class EnvConfig:
    """The reaching task (paper, section 3). Defaults are the paper's training settings."""

    robot: str = "irb120"
    """A name in ``ROBOTS``, or the TOML file of a robot of your own."""

    targets: tuple[str, ...] = ("mug", "bottle", "cereal_box")
    """Names in ``TARGETS`` or TOML files; one is drawn uniformly for each episode."""

    colours: Literal["fixed", "randomized"] = "fixed"
    """Always a target's first colour, or one of its colours drawn for each episode."""

    dynamics: Literal["dynamic", "kinematic"] = "dynamic"
    """Servos, inertia and contacts, or joint angles set exactly."""

    max_episode_steps: int = 50
    """Steps after which an episode is truncated."""

    success_distance_m: float = 0.05
    """Largest distance between gripper and grasp point that counts as reached [m]."""

    success_angle_deg: float = 15.0
    """Largest angle between gripper and grasp frame that counts as reached [deg]."""

    ignore_roll: bool = False
    """Leave the rotation about the approach axis out of the angle."""

    mpi_rad: float = 0.10
    """Maximum position increment, the largest joint step of an action [rad] (slides: [m])."""

    image_size: int = 64
    """Width and height of the image [px]."""

    renderer: Literal["raycast", "opengl"] = "raycast"
    """Our ray caster, or MuJoCo's own renderer as the (slow) reference."""

    antialiasing: bool = True
    """Average several rays where a pixel holds an edge (ray caster only)."""

    randomization: VisualRandomization = field(default_factory=VisualRandomization)
    """What varies in the image besides the paper's colours: all off by default."""

    held_out: HeldOut | None = None
    """Colours and places kept for a test of generalization; None keeps none."""

    def __post_init__(self) -> None:
        _one_of("colours", self.colours, ("fixed", "randomized"))
        _one_of("dynamics", self.dynamics, ("dynamic", "kinematic"))
        _one_of("renderer", self.renderer, ("raycast", "opengl"))
        for name in ("success_distance_m", "success_angle_deg", "mpi_rad"):
            value = getattr(self, name)
            if not value > 0:
                raise UserError(f"EnvConfig.{name} must be greater than 0, got {value}.")
        if self.max_episode_steps < 1:
            raise UserError(
                f"EnvConfig.max_episode_steps must be at least 1, got {self.max_episode_steps}."
            )
        if not 1 <= self.image_size <= MAX_IMAGE_SIZE:
            raise UserError(
                f"EnvConfig.image_size must lie in 1 to {MAX_IMAGE_SIZE}, got {self.image_size}."
            )
        if not self.targets:
            raise UserError("EnvConfig.targets is empty; name at least one target.")
        if len(set(self.targets)) != len(self.targets):
            raise UserError(
                f"EnvConfig.targets holds a name twice: {', '.join(self.targets)}; name each once."
            )


def _one_of(field: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise UserError(f"EnvConfig.{field} must be one of {', '.join(allowed)}, got {value!r}.")
