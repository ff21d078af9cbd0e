"""The installed MuJoCo, and marks of tests that need a newer one."""

import pytest

from knowarm.world.batch import MUJOCO
from knowarm.world.tasks.skills.lift.model import OLDEST_MUJOCO

LIFTS = pytest.mark.skipif(MUJOCO < OLDEST_MUJOCO, reason="MuJoCo before 3.16")
"""Mark of tests with fingers or solid objects."""
