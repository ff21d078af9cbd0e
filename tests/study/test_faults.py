from pathlib import Path

import pytest

from tests.robustness.study_storm import HELPED, kill_study


@pytest.mark.slow(60)
@pytest.mark.skipif(not Path("/dev/shm").is_dir(), reason="needs /proc and /dev/shm")
def test_kills_change_nothing():
    # Of a driver, a worker and a helper; `make torture` takes twenty, and two runs at once.
    assert kill_study(3, seed=0, experiments=(HELPED,)) == (3, [])
