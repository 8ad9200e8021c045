"""The learners on a real benchmark, through the script that reports them."""

import pytest

from baselines.benchmarks.hallway import STANDARD_ERRORS, WANTED, run


@pytest.mark.parametrize("name", WANTED)
def test_learners_reach_their_value_on_hallway(name):
    result = run(name, seed=0)
    assert result.exact > WANTED[name]
    assert abs(result.mean - result.exact) <= STANDARD_ERRORS * result.error
    assert result.seconds < 60
