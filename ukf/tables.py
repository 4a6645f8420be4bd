"""The estimate as a table on disk."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crane_exudyn.files import replacing

if TYPE_CHECKING:
    from .estimate import Estimate


def write_csv(estimate: Estimate, path: str | Path) -> None:
    """Write one row an instant: time, inputs, each state with its 95 % limits, innovations with their std, NIS."""
    names, columns = ["time[s]", "U_lift[dimensionless]", "U_tilt[dimensionless]"], [estimate.time]
    columns += [estimate.inputs[:, 0], estimate.inputs[:, 1]]
    low, high = estimate.interval()
    for i, name in enumerate(estimate.state_names):
        unit = estimate.units.get(name, "") or "dimensionless"
        names += [f"{name}[{unit}]", f"{name}_low95[{unit}]", f"{name}_high95[{unit}]"]
        columns += [estimate.mean[:, i], low[:, i], high[:, i]]
    for i, name in enumerate(estimate.channel_names):
        unit = estimate.units.get(name, "") or "dimensionless"
        names += [f"innovation_{name}[{unit}]", f"innovation_std_{name}[{unit}]"]
        columns += [estimate.innovation[:, i], estimate.innovation_std[:, i]]
    names.append("nis[dimensionless]")
    columns.append(estimate.nis)
    _write(Path(path), names, np.column_stack(columns))


def _write(path: Path, names: list[str], table: np.ndarray) -> None:
    with replacing(path) as temporary:
        opener = gzip.open if path.suffix == ".gz" else open
        with opener(temporary, "wt", encoding="utf-8", newline="") as stream:
            stream.write(",".join(names) + "\n")
            np.savetxt(stream, table, delimiter=",", fmt="%.9g")
