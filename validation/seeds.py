"""Seeds of series of cases, as their command lines name them."""

from __future__ import annotations


def seed_range(text: str) -> range:
    """Return the seeds of "FIRST-LAST", or of one number alone. Raises ValueError for anything else."""
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)
