"""What commands print and write: text and tables for people, JSON for machines, progress for the patient."""

from __future__ import annotations

import dataclasses
import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

STANDARD_OUTPUT = "-"


def jsonable(value: Any) -> Any:
    """Return `value` in what JSON knows: numpy becomes lists and numbers, NaN and infinities become null."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {f.name: getattr(value, f.name) for f in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(k): jsonable(v) for k, v in value.items()}
    if isinstance(value, str | bool) or value is None:
        return value
    if isinstance(value, list | tuple | set | frozenset):
        return [jsonable(v) for v in value]
    if hasattr(value, "tolist"):  # numpy arrays and numbers
        return jsonable(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if isinstance(value, int) else str(value)


def json_text(document: Any) -> str:
    """Return `document` as JSON text with a newline at its end."""
    return json.dumps(jsonable(document), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def write_json(destination: str | Path | None, document: Any) -> None:
    """Write the machine-readable result to a file, whole or not at all; "-" is standard output, None writes nothing."""
    if destination is None:
        return
    if str(destination) == STANDARD_OUTPUT:
        sys.stdout.write(json_text(document))
        return
    from crane_exudyn.files import write_text

    write_text(destination, json_text(document))


class Printer:
    """Prints for people on standard output, unless `--json -` has taken that for the JSON result."""

    def __init__(self, json: str | None = None) -> None:
        self.quiet = json == STANDARD_OUTPUT

    def line(self, text: str = "") -> None:
        """Print one line of text."""
        if not self.quiet:
            print(text)

    def table(self, title: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
        """Print a table: columns of numbers right, columns of text left."""
        if self.quiet:
            return
        from rich import box
        from rich.table import Table

        table = Table(title=title or None, title_justify="left", box=box.SIMPLE_HEAD, show_edge=False, pad_edge=False)
        for i, column in enumerate(columns):
            numbers = all(row[i] is None or isinstance(row[i], int | float) for row in rows)
            table.add_column(column, justify="right" if numbers else "left")
        for row in rows:
            table.add_row(*(_cell(value) for value in row))
        _console().print(table)


def _console() -> Any:
    from rich.console import Console

    class Honest(Console):
        """A console that leaves it to us what happens when the reader has gone."""

        def on_broken_pipe(self) -> None:
            raise

    return Honest(markup=False, highlight=False, width=_width())


def _width() -> int | None:
    """Return a wide page where nobody watches, so that piped tables are not cut; None lets the terminal decide."""
    return None if sys.stdout.isatty() else 160


def _cell(value: object) -> str:
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


@contextmanager
def progress(text: str, json: str | None = None) -> Iterator[Callable[[float], None]]:
    """Yield a function that takes the fraction done; shows a bar on standard error when that is a terminal."""
    if not sys.stderr.isatty():
        yield lambda fraction: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(text, total=1.0)
        yield lambda fraction: bar.update(task, completed=min(fraction, 1.0))


def announce_compilation() -> None:
    """Say on standard error that the first run after an installation or a change takes longer, if this is one."""
    from crane_exudyn.compiled import cache_folder

    if not cache_folder("validation").is_dir():
        print("First run: the equations are compiled once, which takes about half a minute.", file=sys.stderr)
