"""The published model files, where they are: read, written and read again."""

import os
from pathlib import Path

import numpy as np
import pytest

from bnprl_envs.model_files import read_model
from tests.envs.model_file_cases import assert_equal, round_trip

REFERENCE = os.environ.get("BNPRL_REFERENCE_MODELS")
SIZES = {
    "shuttle.95.POMDP": (8, (3,), (5,), 0.95, "ase"),
    "cheese.95.POMDP": (11, (4,), (7,), 0.95, "e"),
    "4x4.95.POMDP": (16, (4,), (2,), 0.95, "e"),
    "1d.noisy.POMDP": (4, (2,), (2,), 0.75, "eo"),
    "tiger.95.POMDP": (2, (3,), (2,), 0.95, "as"),
    "Hallway.pomdp": (60, (5,), (21,), 0.95, "e"),
    "TagAvoid.pomdp": (870, (5,), (30,), 0.95, "as"),
    "dectiger.dpomdp": (2, (3, 3), (2, 2), 1.0, "as"),
    "broadcastChannel.dpomdp": (4, (2, 2), (2, 2), 1.0, "as"),
    "recycling.dpomdp": (4, (3, 3), (2, 2), 0.9, "as"),
    "boxPushingUAI07.dpomdp": (100, (4, 4), (5, 5), 1.0, "as"),
    "Mars.dpomdp": (256, (6, 6), (8, 8), 1.0, "as"),
}


@pytest.mark.skipif(not REFERENCE, reason="BNPRL_REFERENCE_MODELS does not name a folder")
@pytest.mark.parametrize("name", SIZES)
def test_reference_file(tmp_path, name):
    path = Path(REFERENCE) / name
    if not path.exists():
        pytest.skip(f"{path} does not exist")
    model = read_model(path)
    n_states, actions, observations, discount, axes = SIZES[name]
    assert (model.n_states, model.action_sizes) == (n_states, actions)
    assert (model.observation_sizes, model.discount) == (observations, discount)
    assert "".join(a for a, n in zip("aseo", model.reward.shape, strict=True) if n > 1) == axes
    again = round_trip(model, tmp_path / f"again{path.suffix}")
    assert_equal(again, model)
    assert again.names == model.names


@pytest.mark.skipif(not REFERENCE, reason="BNPRL_REFERENCE_MODELS does not name a folder")
@pytest.mark.parametrize(
    ("name", "table"), [("TagAvoid.pomdp", "T"), ("TagAvoid.pomdp", "O"), ("Hallway.pomdp", "T")]
)
def test_reference_entries_by_a_naive_parser(name, table):
    """Tables given by single entries, written one after the other into a dense array."""
    path = Path(REFERENCE) / name
    if not path.exists():
        pytest.skip(f"{path} does not exist")
    model = read_model(path)
    last = model.names.states if table == "T" else model.names.observations[0]
    words = (model.names.actions[0], model.names.states, last)
    dense = np.zeros([len(names) for names in words])
    for line in path.read_text().splitlines():
        parts = line.split("#")[0].replace(":", " ").split()
        if parts and parts[0] == table and len(parts) == 5:
            pairs = zip(words, parts[1:4], strict=True)
            place = [slice(None) if word == "*" else names.index(word) for names, word in pairs]
            dense[tuple(place)] = float(parts[4])
    read = model.transition if table == "T" else model.observation
    given_by_entries = dense.any(axis=2)
    assert given_by_entries.mean() > 0.9
    np.testing.assert_allclose(read[given_by_entries], dense[given_by_entries], atol=2e-6)
