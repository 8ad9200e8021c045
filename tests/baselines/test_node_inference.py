"""What the benchmark of node inference lets pass."""

import pytest

from baselines.benchmarks.node_inference import Outcome, failures, main

GOOD = Outcome([0.72, 0.73, 0.71], [3.0, 4.0, 5.0])


@pytest.mark.parametrize(
    ("few", "many", "failed"),
    [
        (GOOD, GOOD, []),
        (GOOD, Outcome([0.68, 0.67, 0.68], [3.0, 4.0, 5.0]), ["memory pays, from many"]),
        (GOOD, Outcome([0.72, 0.73, 0.71], [9.0, 8.0, 9.0]), ["about as many nodes"]),
        (Outcome(GOOD.values, [1.0, 4.0, 5.0]), GOOD, ["no collapse"]),
        (GOOD, Outcome(GOOD.values, [12.0, 12.0, 12.0]), ["shrinks from many"]),
    ],
)
def test_each_line_fails_alone(few, many, failed):
    assert set(failed) <= set(failures(few, many))
    assert bool(failed) == bool(failures(few, many))


def test_the_command_prints_every_run(capsys):
    assert main(["--seeds", "1", "--episodes", "20"]) in (0, 1)
    assert capsys.readouterr().out.count("seed 0: value 0.") == 2
