"""Policies on the belief of a learned hidden Markov model."""
