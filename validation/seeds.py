"""Seeds of series of cases, as their command lines name them, and sizes that are drawn with them."""

from __future__ import annotations

import math

import numpy as np


def seed_range(text: str) -> range:
    """Return the seeds of "FIRST-LAST", or of one number alone. Raises ValueError for anything else."""
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a number between two ends whose logarithm is equally likely everywhere."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))
