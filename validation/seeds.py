"""Seeds of series of cases, as their command lines name them, and sizes that are drawn with them."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np


def seed_range(text: str) -> range:
    """Return the seeds of "FIRST-LAST", or of one number alone. Raises ValueError for anything else."""
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


def series_parser(module: str, about: str | None, seeds: str) -> argparse.ArgumentParser:
    """Return the command line of a series, `seeds` of it by default: file of results, seeds, processes."""
    parser = argparse.ArgumentParser(prog=f"python -m validation.{module}", description=about)
    parser.add_argument("results", type=Path, help="results file, a JSON a line")
    parser.add_argument("--seeds", type=seed_range, default=seeds, help="FIRST-LAST (default %(default)s)")
    parser.add_argument("--jobs", type=int, default=1)
    return parser


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Return a number between two ends whose logarithm is equally likely everywhere."""
    return float(np.exp(rng.uniform(math.log(low), math.log(high))))
