"""What figure 6.3 and the benchmark of table 6.2 are made of."""

import numpy as np

from baselines.benchmarks import stick_breaking
from baselines.experiments.figure_6_3 import HELP, HelpedTraffic, units
from bnprl_envs import GridTrafficBatch
from bnprl_envs.hand_coded import follow_longer_queue


class Watched(GridTrafficBatch):
    """Keeps what was done."""

    def step(self, actions):
        self.done = actions
        return super().step(actions)


def test_lights_follow_the_heuristic_here_and_there():
    rng, env = np.random.default_rng(0), Watched(50)
    helped, changed, differs = HelpedTraffic(env), 0, 0
    seen, _ = helped.reset(seed=1)
    for _ in range(20):
        wanted = np.zeros(seen.shape, dtype=np.int64)
        heuristic = follow_longer_queue(seen, 0, rng)
        seen, *_ = helped.step(wanted)
        moved = env.done != wanted
        assert (env.done[moved] == heuristic[moved]).all()
        changed, differs = changed + moved.sum(), differs + (heuristic != wanted).sum()
    assert abs(changed / differs - HELP) < 0.02


def test_a_seed_fixes_the_turns_of_the_heuristic():
    helped = HelpedTraffic(GridTrafficBatch(3))
    actions = np.ones((3, 100), dtype=np.int64)
    runs = []
    for _ in range(2):
        helped.reset(seed=2)
        runs.append([helped.step(actions)[1].tolist() for _ in range(30)])
    assert runs[0] == runs[1]


def test_units_of_a_policy_that_never_opens_a_line():
    mixed = np.arange(100) % 2
    assert (
        units(lambda seen, t: np.broadcast_to(mixed ^ (np.arange(100) // 10 % 2), seen.shape)) == 0
    )


def test_the_kept_records_of_table_6_2_are_judged(capsys):
    stick_breaking.main([])
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 6
    assert sum(line.endswith("pass") for line in lines) == 4  # all but the broadcast channel


def test_records_that_are_not_there_fail(tmp_path, capsys):
    assert stick_breaking.main([str(tmp_path)]) == 1
    assert capsys.readouterr().out.count("no finished runs: FAIL") == 5
