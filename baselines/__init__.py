"""How learners are compared: contenders by name, one evaluation for all, experiments as data."""
