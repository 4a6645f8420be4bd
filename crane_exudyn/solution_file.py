"""Exudyn's solution files, which `LoadSolutionFile` reads and SolutionViewer plays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from .errors import CraneError
from .files import replacing


def write_solution(path: str | Path, table: np.ndarray) -> None:
    """Write a run as a solution file, whole or not at all: time in s and coordinates (n, 1 + coordinates)."""
    with replacing(path) as temporary:
        np.savetxt(temporary, table, fmt="%.9g", delimiter=",", header=_header(table.shape), comments="")


def read_solution(path: str | Path) -> dict[str, Any]:
    """Return the contents of a solution file as Exudyn's viewer takes it. Raises CraneError for another file."""
    from exudyn.utilities import LoadSolutionFile

    try:
        solution: dict[str, Any] = LoadSolutionFile(str(path), verbose=False)
    except (OSError, ValueError, IndexError) as problem:
        raise CraneError(f"{path}: not an Exudyn solution file ({problem}). Write one with --save-solution.") from None
    return solution


def _header(shape: tuple[int, ...]) -> str:
    count = shape[1] - 1
    lines = [
        "#Exudyn generic solver solution file",
        "#simulation started=0",
        "#columns contain: time, ODE2 displacements",
        f"#number of system coordinates [nODE2, nODE1, nAlgebraic, nData] = [{count},0,0,0]",
        "#number of written coordinates [nODE2, nVel2, nAcc2, nODE1, nVel1, nAlgebraic, nData] = "
        f"[{count},0,0,0,0,0,0]",
        f"#total columns exported  (excl. time) = {count}",
        f"#number of time steps (planned) = {shape[0] - 1}",
        "#",
    ]
    return "\n".join(lines)
