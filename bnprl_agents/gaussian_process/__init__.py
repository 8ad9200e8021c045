"""Q-learning with Gaussian processes, chapter 3."""
