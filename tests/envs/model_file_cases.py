"""Small model files, and what tests of reading and writing share."""

import numpy as np
import pytest

from bnprl_envs.model_files import ModelFileError, read_model, write_model

PREAMBLE = """discount: 0.5
values: reward
states: left right
actions: go stay
observations: dark light
"""
BODY = "T: * identity\nO: * uniform\n"
JOINT = """agents: 2
discount: 1
values: reward
states: a b c
start:
uniform
actions:
x y
3
observations:
p q
2
"""
FULLY_OBSERVED = "discount: 0.9\nvalues: reward\nstates: a b\nactions: 1\nT: 0 uniform\n"
JOINT_BODY = "T: * :\nidentity\nO: * :\nuniform\n"


def failure(read, text):
    with pytest.raises(ModelFileError) as caught:
        read(text)
    return caught.value


def assert_equal(first, second):
    """Equal bit for bit; the constructor is run on both (`replace`), as it divides by sums."""
    second = second.replace()
    for name in ("transition", "observation", "start", "terminal"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), strict=True)
    np.testing.assert_array_equal(first.reward, second.reward, strict=True)
    assert first.discount == second.discount
    assert first.action_sizes == second.action_sizes
    assert first.observation_sizes == second.observation_sizes
    assert first.fully_observed == second.fully_observed


def round_trip(model, path):
    write_model(model, path)
    return read_model(path)
