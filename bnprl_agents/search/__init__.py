"""Search over deterministic controllers of a team, from a simulator alone."""
