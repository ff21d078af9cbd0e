"""By how much the image varies goes in, checked; all of it is off by default."""

from dataclasses import dataclass

from knowarm.errors import UserError

MAX_DISTRACTORS = 4
FIXED_DRAWS, DRAWS_PER_DISTRACTOR = 16, 5


@dataclass(frozen=True, kw_only=True)
class VisualRandomization:
    """What varies from episode to episode besides the paper's colours; all off by default."""

    light: float = 0.0
    """Brightness of headlight and sun varies by up to this share, 0 to 1."""

    light_angle_deg: float = 0.0
    """The sun's direction turns by up to this angle about x and about y [deg]."""

    camera_shift_m: float = 0.0
    """The camera moves by up to this much along each axis [m]."""

    camera_turn_deg: float = 0.0
    """The camera turns by up to this angle about each of its axes [deg]."""

    surface_colour: float = 0.0
    """Red, green and blue of floor and table vary by up to this, 0 to 1."""

    distractors: int = 0
    """Objects of other shapes and random colours that stand about, 0 to 4."""

    def __post_init__(self) -> None:
        for name, most in (
            ("light", 1.0),
            ("light_angle_deg", 60.0),
            ("camera_shift_m", 0.5),
            ("camera_turn_deg", 30.0),
            ("surface_colour", 1.0),
            ("distractors", MAX_DISTRACTORS),
        ):
            value = getattr(self, name)
            if not 0 <= value <= most:
                raise UserError(
                    f"VisualRandomization.{name} must lie in 0 to {most:g}, got {value}."
                )

    @property
    def draws(self) -> int:
        """Uniform numbers an episode needs; 0 when everything is off."""
        off = self == VisualRandomization()
        return 0 if off else FIXED_DRAWS + DRAWS_PER_DISTRACTOR * self.distractors
