"""`patu sample`: recordings to play with."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .compiling import compile_for
from .options import DEFAULT_CRANE, CraneOption, EffectsOption, JsonOption, looked_at
from .output import Printer
from .outputs import Writes, saving
from .reading import load_crane

if TYPE_CHECKING:
    from validation.sample import Sample

_FILES = ("*.csv", "logger.toml")


def command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Folder to write to."), Writes(files=_FILES)],
    crane: CraneOption = DEFAULT_CRANE,
    effects: EffectsOption = None,
    json: JsonOption = None,
) -> None:
    """Simulate and write example recordings: one that agrees with the crane file, one with a hidden effect, and some
    as loggers record them.
    """
    chosen = load_crane(crane, effects)
    from validation.sample import samples

    compile_for("exudyn")
    made = samples(chosen)
    printer, given = Printer(json), looked_at(crane, effects)
    with saving(printer) as save:
        for sample in made:
            if save(folder / sample.file, partial(_write, sample)):
                printer.line(f"  {sample.text[0].upper()}{sample.text[1:]}. Try: {sample.command_line(folder, given)}")
        save.json(json, {"files": {s.file: {"text": s.text, "try": s.command_line(folder, given)} for s in made}})


def _write(sample: Sample, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    sample.save(path)
