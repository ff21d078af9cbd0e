import pytest

from knowarm.errors import UserError
from knowarm.world.config import EnvConfig


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mpi_rad": 0}, r"mpi_rad must be larger than 0, got 0"),
        ({"mpi_rad": float("nan")}, r"mpi_rad must be a finite number, got nan"),
        ({"image_size": 0}, r"image_size must be between 1 and 4096, got 0"),
        ({"success_distance_m": -1.0}, r"success_distance_m must be larger than 0"),
        ({"success_angle_deg": -1.0}, r"success_angle_deg must be larger than 0"),
        ({"max_episode_steps": -1}, r"max_episode_steps must be at least 1"),
        ({"targets": ("mug", "mug")}, r"contains a name twice"),
        ({"colours": "any"}, r"colours 'any'. Available: fixed, randomized"),
        ({"dynamics": "fast"}, r"dynamics 'fast'. Available: dynamic, kinematic"),
        ({"renderer": "raster"}, r"renderer 'raster'.*raycast"),
    ],
)
def test_each_bad_field_is_named_with_what_is_allowed(
    options: dict, message: str
) -> None:
    with pytest.raises(UserError, match=rf"EnvConfig\.?.*{message}"):
        EnvConfig(**options)


def test_one_target_needs_no_tuple() -> None:
    assert EnvConfig(targets="mug").targets == ("mug",)
