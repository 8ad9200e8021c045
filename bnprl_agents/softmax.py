"""Distributions from unbounded parameters."""

from __future__ import annotations

import numpy as np

from bnprl_agents.episodes import FloatArray


def softmax(logits: FloatArray) -> FloatArray:
    """Distributions over the last axis."""
    weights = np.exp(logits - logits.max(axis=-1, keepdims=True))
    shares: FloatArray = weights / weights.sum(axis=-1, keepdims=True)
    return shares


def softmax_gradient(shares: FloatArray, gradient: FloatArray) -> FloatArray:
    """Gradient by the logits from the one by the shares: y (g - sum y g), over the last axis."""
    mean = (shares * gradient).sum(axis=-1, keepdims=True)
    slope: FloatArray = shares * (gradient - mean)
    return slope
