"""`patu learn`: laws that nobody wrote."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crane_exudyn.errors import CraneError

from .options import (
    DEFAULT_CRANE,
    AnywayOption,
    CheckOption,
    CraneOption,
    EffectsOption,
    JobsOption,
    JsonOption,
    MapFileOption,
    MapOption,
    PerRecordingOption,
    PlotOption,
    RecordingsArgument,
    ReportOption,
    SchedulerOption,
)
from .output import Printer, progress
from .outputs import Saver, Writes, saving
from .reading import listed, load_crane, load_with_check

if TYPE_CHECKING:
    from crane_exudyn.crane import Crane
    from validation.learned.learned_law import LearnedLaw
    from validation.learning import Learned


def python_file(path: Path) -> None:
    """Refuse a file whose name cannot be an effect's."""
    if path.suffix != ".py" or not path.stem.isidentifier():
        raise CraneError(
            f"{path}: the effect is named after the file. Use letters, digits and underscores, as in my_effect.py."
        )


def command(
    recordings: RecordingsArgument,
    check: CheckOption = None,
    per_recording: PerRecordingOption = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="NEW.toml", help="Crane file with the laws."), Writes()
    ] = None,
    write: Annotated[
        Path | None,
        typer.Option("--write", metavar="EFFECT.py", help="Write the law as your own effect."),
        Writes(python_file),
    ] = None,
    crane: CraneOption = DEFAULT_CRANE,
    effects: EffectsOption = None,
    mapping: MapOption = None,
    map_file: MapFileOption = None,
    anyway: AnywayOption = False,
    jobs: JobsOption = 2,
    scheduler: SchedulerOption = None,
    plot: PlotOption = None,
    report: ReportOption = None,
    json: JsonOption = None,
) -> None:
    """Learn a law that the library does not have: the balance in which something is missing, the place, the variable
    on which it depends, and its curve.

    The curve has intervals. It covers only the range that the recording visited, and is given only if it predicts data
    that was left out. If an effect of the library does as well, or nothing is found, no law is given (exit status 0).
    """
    chosen = load_crane(crane, effects)
    measured, other = load_with_check(
        recordings, check, chosen, mapping, map_file, anyway=anyway, needs=("semi-recursive", "filter", "fit")
    )
    from validation.learning import learn
    from validation.workers import scheduled

    with progress("Learn") as done, scheduled(scheduler):
        result = learn(
            chosen,
            measured,
            other,
            per_recording=per_recording or (),
            jobs=jobs,
            progress=lambda part, share: done(share, part),
        )
    from validation.learned.report import report_learned
    from validation.plots import save as save_figure

    printer = Printer(json)
    tell(printer, result)
    given = {"check": other.name if other else None, "own effects": listed(effects) or None}
    with saving(printer) as save:
        _save_laws(save, result, chosen, output, write)
        save.json(json, {"recording": listed(recordings), "crane": chosen.name} | result.to_dict())
        save(plot, lambda path: save_figure(result.plot(), path))
        save(report, lambda path: report_learned(result, path, given))


def _save_laws(save: Saver, result: Learned, chosen: Crane, output: Path | None, write: Path | None) -> None:
    """Write the crane file with the laws, and the first law as an effect of one's own; say so where there is none."""
    from crane_exudyn.files import write_text
    from validation.learned.own_effect import own_effect

    if result.laws:
        save(output, result.crane.save, result.crane.to_toml())
        save(write, lambda path: write_text(path, own_effect(result.laws[0], chosen, result.recording, path.stem)))
    elif output is not None or write is not None:
        print("No law was found, so no crane file and no effect were written.", file=sys.stderr)


def tell(printer: Printer, found: Learned) -> None:
    """Print the laws with their curves, what is tied with them, and the errors."""
    from validation.learning import sentence

    text = sentence(found)
    printer.line(f"{text[0].upper()}{text[1:]}.")
    for law in found.laws:
        _tell_law(printer, law)
    for note in found.notes:
        printer.line(f"note: {note}.")
    if found.next_manoeuvre:
        printer.line(f"Next: {found.next_manoeuvre}")
    if found.check_error_before == found.check_error_before:
        printer.line(f"On the check recording: error {found.check_error_before:.3g} -> {found.check_error_after:.3g}.")
    printer.line(f"({found.seconds:.0f} s)")


def _tell_law(printer: Printer, law: LearnedLaw) -> None:
    from validation.learned.resembles import read_in

    unit, one = read_in(law.unit_over)
    acts = "against motion, " if law.against_motion else ""
    printer.line(f"{law.effect}: {acts}known from {law.x[0] / one:.3g} to {law.x[-1] / one:.3g} {unit} only")
    printer.table("", *law.table())
    if law.tied_with:
        printer.line(f"  this recording cannot separate it from {', or '.join(law.tied_with)}")
