"""Bring a POMDP file of your own: see how good a policy can be, and learn one.

Run: python examples/my_pomdp_file.py
"""

import argparse
import tempfile
from pathlib import Path

from baselines.cli import main as bnprl

MODEL = """
# A machine that breaks unseen: work earns while it is whole, a look costs, a repair costs more.
discount: 0.95
values: reward
states: whole broken
actions: work look repair
observations: nothing fine bad
start: 1 0

T: work
0.9 0.1
0 1
T: look
identity
T: repair : * : whole 1

O: * : * : nothing 1
O: look
0 0.9 0.1
0 0.2 0.8

R: work : whole : * : * 1
R: look : * : * : * -0.2
R: repair : * : * : * -2
"""

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", default="300000")
options = parser.parse_args()

folder = Path(tempfile.mkdtemp())
file = folder / "machine.POMDP"
file.write_text(MODEL)
bnprl(["bounds", str(file), "--seconds", "2", "--no-progress"])
out = str(folder / "out")
learn = ["--agents", "predictive-actor-critic", "actor-critic", "random", "--steps", options.steps]
bnprl(["compare", str(file), *learn, "--seeds", "2", "--eval-points", "4", "--out", out])
