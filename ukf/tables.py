"""The estimate as a table on disk."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from crane_exudyn.formats import write_table

if TYPE_CHECKING:
    from .estimate import Estimate


def write_estimate(estimate: Estimate, path: str | Path) -> None:
    """Write .csv, .csv.gz, .parquet or .mat, one row an instant: time, inputs, each state with its 95 % limits,
    innovations with their std, NIS.
    """
    names = ["time[s]", *(f"U_{name}[dimensionless]" for name in estimate.layout.cylinders)]
    columns = [estimate.time, *estimate.inputs[:, estimate.layout.spools].T]
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
    for name, probability in estimate.models.items():
        names.append(f"probability_{name}[dimensionless]")
        columns.append(probability)
    write_table(path, dict(zip(names, columns, strict=True)), digits=9)
