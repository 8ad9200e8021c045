import re
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import gymnasium as gym
import pytest
from gymnasium.envs.registration import EnvSpec

import bnprl_envs
from bnprl_envs import registry
from bnprl_envs.memoryless import memoryless_value
from bnprl_envs.planning import fib, mdp_value, random_value
from bnprl_envs.stochastic_memoryless import stochastic_memoryless_policy

ROOT = Path(__file__).parents[2]
IDS = bnprl_envs.environment_ids()
GYMNASIUM = [id for id in IDS if not bnprl_envs.entry(id).kind.startswith("parallel")]
TABULAR = [id for id in IDS if bnprl_envs.entry(id).kind == "tabular"]


def test_the_ids_of_this_release():
    assert {"bnprl/Hallway-v0", "bnprl/Tag-v0"} <= set(IDS)


@pytest.mark.parametrize("id", GYMNASIUM)
def test_every_id_is_known_to_gymnasium_with_its_horizon(id):
    assert gym.spec(id).max_episode_steps == bnprl_envs.entry(id).horizon
    assert EnvSpec.from_json(gym.spec(id).to_json()) == gym.spec(id)


@pytest.mark.parametrize("id", TABULAR)
def test_an_entry_agrees_with_its_model(id):
    entry, model = bnprl_envs.entry(id), bnprl_envs.model(id)
    values = {reference.name: reference.value for reference in entry.references}
    assert model.discount == entry.discount
    assert values["random"] == pytest.approx(random_value(model), abs=2e-5)
    rungs = [values[name] for name in ("random", "memoryless", "lower", "upper") if name in values]
    rungs.append(model.start @ mdp_value(model))
    assert all(low <= high + 1e-6 for low, high in pairwise(rungs))
    assert model.fully_observed or values["random"] < values["memoryless"] < values["lower"]


@pytest.mark.parametrize("id", IDS)
def test_every_reference_says_where_it_comes_from(id):
    references = bnprl_envs.entry(id).references
    assert len({reference.name for reference in references}) == len(references) > 1
    for reference in references:
        files = re.findall(r"pytest (\S+)", reference.source)
        assert all((ROOT / file).is_file() for file in files)
        assert reference.source[0].isalpha()


LISTED = [(id, r) for id in IDS for r in bnprl_envs.entry(id).references if r.policy]


@pytest.mark.parametrize(("id", "reference"), LISTED)
def test_a_listed_policy_has_its_value_exactly(id, reference):
    value = memoryless_value(bnprl_envs.model(id), list(map(list, reference.policy)))
    assert value == pytest.approx(reference.value, abs=1e-6)


@pytest.mark.parametrize("name", ["Shuttle", "CheeseMaze", "Grid4x4", "NoisyMaze1D", "Tiger"])
def test_a_search_reaches_the_memoryless_value(name):
    values = {r.name: r.value for r in bnprl_envs.entry(f"bnprl/{name}-v0").references}
    found = stochastic_memoryless_policy(bnprl_envs.model(f"bnprl/{name}-v0"), restarts=10)
    assert found.value == pytest.approx(values["memoryless"], abs=1e-5)


@pytest.mark.parametrize("id", [id for id in IDS if "tabular" in bnprl_envs.entry(id).kind])
def test_computed_upper_bounds(id):
    model = bnprl_envs.model(id)
    reference = next(r for r in bnprl_envs.entry(id).references if r.name == "upper")
    if reference.source.startswith("fast informed bound"):
        assert (fib(model) @ model.start).max() == pytest.approx(reference.value, abs=1e-6)
    elif reference.source.startswith("exact: bnprl bounds"):
        assert model.start @ mdp_value(model) == pytest.approx(reference.value, abs=1e-6)
    else:
        assert reference.value <= (fib(model) @ model.start).max() + 1e-6


def test_arguments_reach_the_benchmark():
    assert not bnprl_envs.model("bnprl/Hallway-v0", resetting=True).terminal.any()
    assert not gym.make("bnprl/Tag-v0", resetting=True).unwrapped.model.terminal.any()
    with pytest.raises(TypeError, match="unexpected keyword argument 'reseting'"):
        bnprl_envs.model("bnprl/Hallway-v0", reseting=True)


def test_equal_calls_share_a_model():
    assert bnprl_envs.model("bnprl/Tag-v0") is bnprl_envs.model("bnprl/Tag-v0")


@pytest.mark.parametrize(
    ("wrong", "near"),
    [
        ("bnprl/Halway-v0", "bnprl/Hallway-v0"),
        ("hallway", "bnprl/Hallway-v0"),
        ("Tag-v0", "bnprl/Tag-v0"),
        ("bnprl/Tag-v1", "bnprl/Tag-v0"),
    ],
)
@pytest.mark.parametrize("function", [bnprl_envs.model, bnprl_envs.entry])
def test_an_unknown_id_names_near_misses(function, wrong, near):
    with pytest.raises(ValueError, match=f"unknown environment '{wrong}'; did you mean.*{near}"):
        function(wrong)


def test_an_id_like_no_other_lists_them_all():
    with pytest.raises(ValueError, match=re.escape(f"known: {', '.join(IDS)}")):
        bnprl_envs.model("zzz")


def test_an_id_without_tables_has_no_model(monkeypatch):
    entry = registry.Entry("bnprl/Pole-v0", "", "somewhere:Pole", 10, 0.9, kind="class")
    monkeypatch.setitem(registry._TABLE, entry.id, entry)
    with pytest.raises(ValueError, match="bnprl/Pole-v0 has no tables"):
        bnprl_envs.model(entry.id)


@pytest.mark.parametrize("make", [gym.make, gym.make_vec])
def test_gymnasium_says_where_a_team_is_to_be_had(make):
    with pytest.raises(gym.error.UnregisteredEnv, match="is a team, a PettingZoo") as caught:
        make("bnprl/DecTiger-v0")
    line = str(caught.value).partition(": ")[2].removesuffix(" makes it")
    assert line == 'pettingzoo.make("parallel", "bnprl/DecTiger-v0")'


def test_public_names():
    for name in (*bnprl_envs.__all__, "TabularVectorEnv"):
        assert getattr(bnprl_envs, name) is not None
    with pytest.raises(AttributeError, match="'bnprl_envs' has no attribute 'nothing'"):
        _ = bnprl_envs.nothing


def test_importing_is_cheap():
    heavy = "{'numba', 'matplotlib', 'PIL', 'pygame', 'torch', 'stable_baselines3'}"
    code = f"import sys, bnprl_envs; sys.exit(', '.join({heavy} & set(sys.modules)) or 0)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"imported: {done.stderr}"
