"""`patu benchmark`: speed and memory, as ratios measured in one run."""

from __future__ import annotations

from typing import Annotated

import typer

from .compiling import compile_for
from .options import DEFAULT_CRANE, CraneOption, EffectsOption, JsonOption
from .output import Printer, progress
from .outputs import saving
from .reading import load_crane


def command(
    only: Annotated[
        list[str] | None,
        typer.Option("--only", metavar="PART", help="start_up, open_loop, filters, diagnosis or memory; repeatable."),
    ] = None,
    crane: CraneOption = DEFAULT_CRANE,
    effects: EffectsOption = None,
    json: JsonOption = None,
) -> None:
    """Measure speed and memory: both engines open loop, the filter and its parts, the naive way, a diagnosis.

    Everything is measured in one run, so the ratios hold for this computer in its present state. The kernels are
    compiled first.
    """
    chosen = load_crane(crane, effects)
    from validation.benchmark import run

    compile_for("exudyn", "semi-recursive", "filter", "fit")
    with progress("Measuring") as done:
        results = run(only, chosen, done)
    document = results.document()
    rows = [(name, m["value"], m["unit"], m["ratio"], m["ratio_to"] or "") for name, m in document.items()]
    printer = Printer(json)
    printer.table("", ("quantity", "value", "unit", "ratio", "to"), rows)
    with saving(printer) as save:
        save.json(json, document)
