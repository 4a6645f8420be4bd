"""What commands print and write: text and tables for people, JSON for machines, progress for the patient."""

from __future__ import annotations

import codecs
import dataclasses
import json
import math
import os
import sys
import threading
import time
import unicodedata
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TextIO

from crane_exudyn.errors import doing

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


def write_out(text: str, stream: TextIO) -> None:
    """Write the text of a result, JSON or TOML, to standard output or error: always in UTF-8, as files of these kinds
    are.
    """
    binary = getattr(stream, "buffer", None)
    if binary is None:  # a program that calls this one has put text of its own in its place
        stream.write(text)
        return
    stream.flush()
    binary.write(text.encode("utf-8", errors="backslashreplace"))
    binary.flush()


#: what stands for a sign that a terminal cannot show, where leaving its accents away does not do
_PLAIN = {
    "…": "...", "–": "-", "—": "-", "−": "-", "±": "+-", "→": "->", "≥": ">=", "≤": "<=", "×": "x", "°": "deg",
    "∞": "inf", "²": "^2", "³": "^3",
    "ż": "dz", "θ": "theta", "µ": "u", "μ": "u", "χ": "chi", "·": "*", "’": "'", "“": '"', "”": '"', "│": "|", "─": "-",
    "━": "-",
}  # fmt: skip


def show_any_sign() -> None:
    """Let standard output and error write what their encoding lacks in signs that it has, instead of failing."""
    codecs.register_error("patu", _plain)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="patu")


def _plain(problem: UnicodeError) -> tuple[str, int]:
    if not isinstance(problem, UnicodeEncodeError):
        raise problem
    signs = problem.object[problem.start : problem.end]
    return "".join(_PLAIN.get(sign) or _bare(sign) for sign in signs), problem.end


def _bare(sign: str) -> str:
    """Return a letter without its accents, or a question mark."""
    if unicodedata.combining(sign):
        return ""
    return unicodedata.normalize("NFKD", sign).encode("ascii", "ignore").decode() or "?"


class Printer:
    """Prints for people on standard output, unless `--json -` has taken that for the JSON result; or, where another
    result stands there, on standard error.
    """

    def __init__(self, json: str | None = None, *, aside: bool = False) -> None:
        self.quiet = json == STANDARD_OUTPUT
        self._aside = aside

    def line(self, text: str = "") -> None:
        """Print one line of text."""
        if not self.quiet:
            stream = sys.stderr if self._aside else sys.stdout
            with self._while_somebody_reads():
                print(text, file=stream, flush=True)  # whoever reads a pipe sees it when it is said

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
        with self._while_somebody_reads():
            _console().print(table)

    @contextmanager
    def _while_somebody_reads(self) -> Iterator[None]:
        """Print nothing more once the reader has seen enough (`patu learn … | head`): files are still to be written."""
        try:
            yield
        except BrokenPipeError:
            self.quiet = True
            stop_writing()


def stop_writing() -> None:
    """Send standard output to nowhere, or Python would complain when it flushes at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


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
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


@contextmanager
def progress(text: str) -> Iterator[Callable[..., None]]:
    """Yield a function that takes the fraction done and, if there is one, the name of what is being done.

    Standard error shows a bar where it is a terminal, and a line every ten seconds where it is not.
    """
    with doing(text), (_bar if sys.stderr.isatty() else _lines)(text) as show:
        yield show


@contextmanager
def _bar(text: str) -> Iterator[Callable[..., None]]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(text, total=1.0)

        def show(fraction: float, part: str = "") -> None:
            described = f"{text}: {part}" if part else None
            bar.update(task, completed=min(fraction, 1.0), description=described)

        yield show


#: s between two lines of progress
PAUSE = 10.0


@contextmanager
def _lines(text: str) -> Iterator[Callable[..., None]]:
    begin, ended, now = time.monotonic(), threading.Event(), [0.0, ""]

    def show(fraction: float, part: str = "") -> None:
        now[:] = min(fraction, 1.0), part or now[1]

    def tell() -> None:
        while not ended.wait(PAUSE):
            said = ": ".join(filter(None, (text, str(now[1]))))
            print(f"{said}, {now[0]:.0%}, {time.monotonic() - begin:.0f} s", file=sys.stderr, flush=True)

    teller = threading.Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield show
    finally:
        ended.set()
        teller.join()
