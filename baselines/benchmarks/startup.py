"""How long it takes to import the environments and to show the help: python -m ...startup.

Exits 1 where one takes longer than it should on an otherwise idle machine.
"""

from __future__ import annotations

import subprocess
import sys
import time

LIMITS = {
    "import bnprl_envs": ("import bnprl_envs", 0.6),
    "bnprl --help": (
        "import baselines.cli as cli\ntry: cli.main(['--help'])\nexcept SystemExit: pass",
        0.8,
    ),
}
"""What is timed -> the code of a fresh interpreter, and the seconds that it may take."""
REPEATS = 7


def seconds(code: str) -> float:
    """Return the least wall-clock of a few fresh interpreters, the files read before."""
    found = []
    for _ in range(REPEATS):
        begun = time.perf_counter()
        subprocess.run([sys.executable, "-c", code], check=True, capture_output=True)
        found.append(time.perf_counter() - begun)
    return min(found)


def main() -> int:
    """Time everything; return the exit code."""
    good = True
    for name, (code, limit) in LIMITS.items():
        taken = seconds(code)
        good &= taken < limit
        print(f"{name:<20} {taken:.2f} s (at most {limit:g})", flush=True)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
