"""The installed MuJoCo, and marks of tests that need a newer one."""

import mujoco
import pytest

from knowarm.world.tasks.skills.lift.model import OLDEST_MUJOCO

VERSION = tuple(map(int, mujoco.mj_versionString().split(".")[:2]))

LIFTS = pytest.mark.skipif(VERSION < OLDEST_MUJOCO, reason="MuJoCo before 3.16")
"""Mark of tests with fingers or solid objects."""
