"""Finite-state controllers: one E-step, several M-steps, schedules and explorations."""
