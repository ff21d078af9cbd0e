from pathlib import Path

import pytest

from tests.robustness.study_storm import HELPED, kill_study


@pytest.mark.slow(40)
@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="needs /proc and /dev/shm")
def test_kills_change_nothing():
    # A driver's death ends its worker, too; `make torture` takes twenty, and two runs at once.
    assert kill_study(2, 0, (HELPED,), ("driver", "helper")) == (2, [])
