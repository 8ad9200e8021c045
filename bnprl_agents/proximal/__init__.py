"""What the learners by proximal policy optimisation on a belief share."""
