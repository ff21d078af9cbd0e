"""A run without a policy cannot be taken out of the simulator."""

from pathlib import Path

import pytest

import knowarm
from knowarm.deploy.contract import deployment
from knowarm.errors import UserError

ZOO = Path(__file__).parents[2] / "zoo"


def test_it_cannot_leave_the_simulator_as_a_policy():
    with pytest.raises(UserError, match="no policy to take out"):
        deployment(knowarm.load_agent(ZOO / "tiago-choose-sort-answers-seen"))
