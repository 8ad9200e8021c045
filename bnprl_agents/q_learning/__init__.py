"""The baselines of chapter 3: Q-learning on tables and on fixed bases."""
