"""Configuration of the task: reaching for one object, or choosing among several."""

from dataclasses import dataclass, field
from typing import Any, Literal

from knowarm.config import check_numbers
from knowarm.errors import UserError
from knowarm.world.choice_config import ChoiceConfig
from knowarm.world.held_out import HeldOut
from knowarm.world.objects import CHOICE_TARGETS
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

    choice: ChoiceConfig | None = None
    """Several objects, of which a query means one (``choice_env_config`` has the defaults of the
    other fields); None shows a single object."""

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
        if self.choice is not None:
            self._check_choice(self.choice)
        if not self.targets:
            raise UserError("EnvConfig.targets is empty; name at least one target.")
        if len(set(self.targets)) != len(self.targets):
            raise UserError(
                f"EnvConfig.targets contains a name twice: {', '.join(self.targets)}; list each "
                "once."
            )

    def _check_choice(self, choice: ChoiceConfig) -> None:
        if choice.objects > len(self.targets):
            raise UserError(
                f"ChoiceConfig.objects is {choice.objects}, and EnvConfig.targets names "
                f"{len(self.targets)}; all objects of an episode are different. Name more targets "
                "or show fewer objects."
            )
        for name, used in (
            ("held_out", self.held_out is not None),
            ("randomization.distractors", self.randomization.distractors > 0),
        ):
            if used:
                raise UserError(
                    f"EnvConfig.{name} cannot be combined with EnvConfig.choice: what stands in "
                    "the rectangle is decided by choice.queries. Leave one of them out."
                )


def choice_env_config(robot: str = DEFAULT_ROBOT, **options: Any) -> EnvConfig:
    """Return the config of the choice task: all its objects, in all their colours.

    Args:
        robot: as ``EnvConfig.robot``.
        options: further fields of ``EnvConfig``, which replace these.
    """
    return EnvConfig(robot=robot, **(CHOICE_DEFAULTS | options))


CHOICE_DEFAULTS: dict[str, Any] = {
    "targets": CHOICE_TARGETS,
    "colours": "randomized",
    "choice": ChoiceConfig(),
}
"""Fields of ``EnvConfig`` in which the choice task differs from reaching."""


def _one_of(field: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise UserError(f"EnvConfig.{field} must be one of {', '.join(allowed)}, got {value!r}.")
