"""A model of ten thousand states is read from a file and steps in little memory."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

N_STATES, N_ACTIONS, SUCCESSORS = 10_000, 4, 10
PREAMBLE = f"""discount: 0.95
values: reward
states: {N_STATES}
actions: {N_ACTIONS}
observations: 3
O: * : * uniform
R: * : 0 : * : * 1
"""
SCRIPT = """
import json, re, sys, time
import numpy as np
import bnprl_envs
from bnprl_envs import TabularEnv, TabularVectorEnv

began = time.process_time()
model = bnprl_envs.read_model(sys.argv[1])
seconds = time.process_time() - began
env, envs = TabularEnv(model, max_episode_steps=50), TabularVectorEnv(model, 1024)
env.reset(seed=0)
envs.reset(seed=0)
rewards = 0.0
for step in range(50):
    rewards += env.step(step % 4)[1] + envs.step(np.full(1024, step % 4))[1].sum()
status = open("/proc/self/status").read()  # ru_maxrss would include the process that forked
peak = int(re.search(r"VmHWM:\\s*(\\d+) kB", status)[1]) / 1024
json.dump({"entries": model.transition_rows.nnz, "MB": peak, "seconds": seconds}, sys.stdout)
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads Linux's /proc")
def test_ten_thousand_states_are_read_and_stepped_in_500_mb(tmp_path):
    path = tmp_path / "large.POMDP"
    with path.open("w") as file:
        file.write(PREAMBLE)
        for row in range(N_ACTIONS * N_STATES):
            action, state = divmod(row, N_STATES)
            for k in range(SUCCESSORS):
                end = (7 * state + 1013 * k + action) % N_STATES
                file.write(f"T: {action} : {state} : {end} {1 / SUCCESSORS}\n")
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(path)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["entries"] == N_ACTIONS * N_STATES * SUCCESSORS
    assert found["MB"] < 500
    assert found["seconds"] < 30, "it takes 4 on one idle core"
