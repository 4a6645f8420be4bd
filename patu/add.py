"""`patu add` puts an effect into a crane file; `patu remove` takes it out again, exactly."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crane_exudyn.errors import CraneError, doing

from .calls import refuse_idle
from .options import DEFAULT_CRANE, AnywayOption, CraneOption, EffectsOption, JsonOption, MapFileOption, MapOption
from .output import STANDARD_OUTPUT, Printer, write_out
from .outputs import Reads, Writes, saving
from .reading import load_checked, load_crane

if TYPE_CHECKING:
    from crane_exudyn.crane import Crane

EffectArgument = Annotated[
    str, typer.Argument(metavar="EFFECT[@PLACE]", help="Effect and place, such as dead_band@tilt.")
]
CraneOutput = Annotated[
    Path | None,
    typer.Option("-o", "--output", metavar="NEW.toml", help="Crane file to write; standard output if left out."),
    Writes(),
]


def command(
    context: typer.Context,
    effect: EffectArgument,
    fit: Annotated[
        Path | None, typer.Option("--fit", metavar="REC", help="Recording to which its parameters are fitted."), Reads()
    ] = None,
    even_if_worse: Annotated[
        bool, typer.Option("--even-if-worse", help="Write the crane even if the fit did not reduce its error.")
    ] = False,
    values: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="A parameter, with its unit.")
    ] = None,
    output: CraneOutput = None,
    crane: CraneOption = DEFAULT_CRANE,
    effects: EffectsOption = None,
    mapping: MapOption = None,
    map_file: MapFileOption = None,
    anyway: AnywayOption = False,
    json: JsonOption = None,
) -> None:
    """Add an effect to a crane file, with parameters fitted to a recording, given values or typical values.

    If the fit does not reduce the open-loop error, or is hardly better than a fit of the nominal parameters alone,
    nothing is written and the exit status is 1. --even-if-worse writes the file anyway.
    """
    idle = ("--even-if-worse", "--map", "--map-file", "--anyway")
    refuse_idle(context, (fit is None, idle, "nothing is fitted without --fit REC"))
    printer = _printer(output, json)
    chosen = load_crane(crane, effects)
    values_given = _parse(chosen, effect, values or [])
    if fit is None:
        from validation.history import added, with_typical

        result = added(chosen, with_typical(chosen, effect, values_given), recording="", evidence=0.0)
        _write(printer, result, output, json, {"effect": effect})
        return
    from validation.selection.fitted import fitted_effect, helped

    [measured] = load_checked([fit], chosen, mapping, map_file, anyway=anyway, needs=("semi-recursive", "fit"))
    with doing(f"fitting {effect} to {fit}"):
        result, document = fitted_effect(chosen, effect, measured, values_given)
    better = helped(document)
    if not better:
        unwritten = "" if even_if_worse else " Nothing was written; --even-if-worse writes it anyway."
        printer.line(
            f"The fit of {effect} to {fit} did not help: error {document['error_before']:.4g} before, "
            f"{document['error_after']:.4g} after, {document['error_without']:.4g} with the nominal parameters "
            f"fitted alone (noise units).{unwritten}"
        )
    else:
        printer.line(_fit_text(chosen, result, effect, document))
    kept = result if better or even_if_worse else None
    _write(printer, kept, output, json, {"effect": effect, **document, "helped": better})
    raise typer.Exit(0 if better else 1)


def remove(
    effect: EffectArgument,
    output: CraneOutput = None,
    crane: CraneOption = DEFAULT_CRANE,
    effects: EffectsOption = None,
    json: JsonOption = None,
) -> None:
    """Remove an effect from a crane file. Parameters that changed when it was added get their old values back, unless
    another effect that was added with it remains.
    """
    from validation.history import moved_in_words, removed

    printer = _printer(output, json)
    before = load_crane(crane, effects)
    after = removed(before, effect)
    moved = moved_in_words(before, after)
    with_it = [e.key for e in after.effects if after.history and e.key in after.history[-1]["added"]]
    if moved:
        printer.line(f"Back to the old values: {moved}.")
    elif with_it and len(after.history) == len(before.history):
        were, remain, it = ("were", "remain", "they are") if len(with_it) > 1 else ("was", "remains", "it is")
        printer.line(
            f"{', '.join(with_it)} {were} added in the same step and {remain}, so the parameters keep their values. "
            f"They get their old values back when {it} removed as well."
        )
    _write(printer, after, output, json, {"effect": effect})


def _fit_text(before: Crane, after: Crane, key: str, document: Mapping[str, Any]) -> str:
    """Return in words what a fit found: the effect's parameters, the errors, and what else moved."""
    from crane_exudyn.crane_toml import unit_at
    from crane_exudyn.effects import registry
    from validation.history import moved_in_words
    from validation.reports import interval_text

    (effect, place), found = registry.split_key(key, before.layout), []
    for p in effect.parameters:
        if p.name in document["parameters"]:
            fitted = document["parameters"][p.name]
            spread = math.inf if fitted["std"] is None else fitted["std"]
            unit = unit_at(p.unit, place, before.layout)
            found.append(f"{p.name} = {interval_text({**fitted, 'std': spread, 'unit': unit})}")
    moved = moved_in_words(before, after)
    return (
        f"{key}: {', '.join(found)}; open-loop error {document['error_before']:.3g} -> {document['error_after']:.3g} "
        "noise units." + (f" Changed with it: {moved}." if moved else "")
    )


def _parse(crane: Crane, key: str, entries: list[str]) -> dict[str, float]:
    from crane_exudyn.crane_toml import unit_at
    from crane_exudyn.errors import nearest
    from crane_exudyn.units import to_si
    from validation.history import addable

    effect, place = addable(crane, key)
    units = {p.name: unit_at(p.unit, place, crane.layout) for p in effect.parameters}
    found = {}
    for entry in entries:
        name, equals, text = (part.strip() for part in entry.partition("="))
        if not equals or name not in units:
            raise CraneError(f"--set {entry!r}: {effect.name} has no parameter {name!r}.{nearest(name, list(units))}")
        found[name] = to_si(text, units[name], f"--set {name}")
    return found


def _printer(output: Path | None, json: str | None) -> Printer:
    """Return what prints sentences: on standard error where the crane file goes to standard output."""
    if output is None and json == STANDARD_OUTPUT:
        raise CraneError("--json - takes standard output; give -o NEW.toml.")
    return Printer(json, aside=output is None)


def _write(
    printer: Printer, crane: Crane | None, output: Path | None, json: str | None, document: dict[str, object]
) -> None:
    """Write the crane, if there is one to write, to its file or to standard output; and the JSON."""
    with saving(printer) as save:
        if crane is not None:
            document |= {"crane": str(output) if output else crane.name, "effects": [e.key for e in crane.effects]}
            if save(output, crane.save, crane.to_toml()):
                printer.line(repr(crane))
            elif output is None:
                write_out(crane.to_toml(), sys.stdout)
        save.json(json, document)
