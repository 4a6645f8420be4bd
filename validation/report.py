"""Reports: one HTML file with the verdict first, then figures, tables, and what is needed to repeat it.

The file needs no network and no second file: pictures stand inside as data, the style is in the page. A report is made
of sections; a section is a title and parts; a part is a paragraph (text), a `Table`, a `Picture`, a matplotlib figure,
or `Links` to files beside it.

    write_report("out/report", "Lift test", "The model explains the recording.",
                 [("Angles", [figure, "The lift boom follows.", Table(("channel", "RMSE"), [("z1", 0.02)])])])
"""

from __future__ import annotations

import base64
import math
import platform
import re
import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from crane_exudyn.display import cell, engineering, table_html
from crane_exudyn.errors import CraneError, named_file, refuse_unknown, shortened
from crane_exudyn.files import write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "FILE_NAME",
    "PACKAGES",
    "Links",
    "Mood",
    "Part",
    "Picture",
    "Section",
    "Table",
    "amount",
    "cell",
    "evidence_difference",
    "next_command",
    "render",
    "table_html",
    "three_digits",
    "write_report",
]

FILE_NAME = "report.html"
#: packages whose version can change a number in a report
PACKAGES = ("crane-exudyn", "exudyn", "numpy", "scipy", "numba", "filterpy", "matplotlib")

#: options that say what a run looked at, and at what machine, by the commands that a result tells to go on with
_MACHINE = ("--map-file", "--map", "--crane", "--effects")
_SEARCH = ("--check", "--per-recording", *_MACHINE, "--anyway")
TAKEN: Mapping[str, Sequence[str]] = {
    "check": _MACHINE,
    "compare": ("--per-recording", *_MACHINE, "--anyway"),
    "diagnose": _SEARCH,
    "improve": _SEARCH,
    "learn": _SEARCH,
}

#: what a run was given, by the flag: one value or several; True stands for a flag alone, None for what was not given
Options = Mapping[str, "str | Path | Sequence[str | Path] | bool | None"]
Mood = Literal["good", "bad", "neutral"]
_MOODS: Mapping[str, str] = {"good": "✓", "bad": "✗", "neutral": "•"}


@dataclass(frozen=True)
class Table:
    """A table of a report.

    Attributes:
        columns: headings, with units.
        rows: cells; floats are shown with four digits, booleans as yes and no, None as a dash.
        title, note: text above and below.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[object]]
    title: str = ""
    note: str = ""

    def __post_init__(self) -> None:
        for row in self.rows:
            if not (hasattr(row, "__len__") and len(row) == len(self.columns)):
                raise CraneError(
                    f"Table {self.title!r}: found the row {shortened(row)}, expected {len(self.columns)} cells, one of "
                    f"each column ({', '.join(map(str, self.columns))}). Give None where there is nothing to show."
                )


@dataclass(frozen=True)
class Picture:
    """A picture of a report.

    Attributes:
        content: matplotlib figure, bytes of a PNG, JPEG or GIF, text of an SVG, or the path of such a file.
        caption: what is seen; also read to those who cannot see it.
    """

    content: Figure | bytes | str | Path
    caption: str


@dataclass(frozen=True)
class Links:
    """A list of links of a report to files that stand in its folder."""

    files: Sequence[Path]


Part = str | Table | Picture | Links | Any
Section = tuple[str, Sequence[Part]]


def write_report(
    directory: str | Path,
    title: str,
    verdict: str,
    sections: Iterable[Section],
    *,
    command: str | None = None,
    seed: int | None = None,
    parameters: Mapping[str, object] | None = None,
    mood: Mood = "neutral",
) -> Path:
    """Write `directory`/report.html, whole or not at all, and return its path.

    Args:
        directory: is made if it does not exist.
        title: what was done, with what.
        verdict: the answer, one or two sentences; stands first.
        sections: (title, parts) in reading order.
        command: the command line that repeats this; by default the one that is running.
        seed: of the random numbers, where any were drawn.
        parameters: what the run was given, by name.
        mood: whether the answer is good news, so that it shows at a glance.

    Raises:
        CraneError: the directory cannot be made, a picture cannot be read, or an unknown mood.
    """
    text = render(title, verdict, sections, command=command, seed=seed, parameters=parameters, mood=mood)
    path = _directory(directory) / FILE_NAME
    write_text(path, text)
    return path


def render(
    title: str,
    verdict: str,
    sections: Iterable[Section],
    *,
    command: str | None = None,
    seed: int | None = None,
    parameters: Mapping[str, object] | None = None,
    mood: Mood = "neutral",
) -> str:
    """Return the report as HTML text; arguments as of `write_report`."""
    refuse_unknown("report", [mood], _MOODS, "mood")
    return (
        _environment()
        .get_template("report.html.j2")
        .render(
            title=title,
            verdict=verdict,
            mood=mood,
            sign=_MOODS[mood],
            sections=[(name, [_part(p) for p in parts]) for name, parts in sections],
            command=command or command_line(),
            seed=seed,
            parameters=[(name, cell(value)) for name, value in (parameters or {}).items()],
            versions=versions(),
        )
    )


def command_line() -> str:
    """Return the command that is running, as one would type it again."""
    program = Path(sys.argv[0]).name if sys.argv and sys.argv[0] else "python"
    name = "patu" if program in ("patu", "__main__.py") else program
    return shlex.join([name, *sys.argv[1:]])


def next_command(name: str, recordings: Iterable[str | Path], options: Options, more: Sequence[str] = ()) -> str:
    """Return a command as one types it to go on from a run: on recordings, with those of the run's options that it
    takes.

    Without them it would look for other columns, or answer for another machine.
    """
    words = ["patu", name, *map(str, recordings)]
    for flag in TAKEN[name]:
        value = options.get(flag)
        if value is True:
            words.append(flag)
        elif value:
            for one in [value] if isinstance(value, str | Path) else value:
                words += [flag, str(one)]
    return shlex.join([*words, *more])


def versions() -> dict[str, str]:
    """Return the versions of Python, of the system and of every package that can change a number."""
    found = {"Python": platform.python_version(), "System": f"{platform.system()} {platform.machine()}"}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:  # a checkout that was never installed still reports
            found[package] = "not installed"
    return found


# -- numbers that stand in several places ----------------------------------------------------------------------------


def three_digits(error: float) -> float:
    """Return an error in units of noise, or a NIS, as the cell of a table: with the three digits of sentences and
    pictures.
    """
    return float(f"{error:.3g}")


def amount(value: float, unit: str) -> str:
    """Return a value in SI in the unit in which engineers read it, such as "219.7 kg"."""
    shown, factor = engineering(unit)
    return f"{value / factor:.4g} {shown}".strip()


def evidence_difference(evidence: float, other: float) -> float:
    """Return by how much log evidence exceeds another's, to whole units as in pictures: tenths decide nothing."""
    difference = evidence - other
    return round(difference) if math.isfinite(difference) else difference


def _directory(directory: str | Path) -> Path:
    path = named_file(directory, "report")
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise CraneError(
            f"{path}: no folder can be created there ({problem.strerror}). Give --report another."
        ) from problem
    return path


def _environment() -> Any:
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("validation", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["code"] = _with_code
    return environment


def _with_code(text: str) -> Any:
    """Return text as HTML in which `such words` are set as code."""
    from markupsafe import Markup

    return Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(text, quote=False))))


def _part(part: Part) -> dict[str, Any]:
    """Return what the template needs of one part."""
    if isinstance(part, str):
        return {"kind": "text", "paragraphs": [p for p in part.split("\n\n") if p.strip()]}
    if isinstance(part, Table):
        return {
            "kind": "table",
            "html": table_html(part.columns, part.rows, title=part.title, note=part.note),
        }
    if isinstance(part, Links):
        return {"kind": "links", "names": [file.name for file in part.files]}
    picture = part if isinstance(part, Picture) else Picture(part, _title_of(part))
    return {"kind": "picture", "caption": picture.caption, "source": _source(picture.content)}


def _title_of(figure: Any) -> str:
    """Return the title that a bare figure carries, or what its axes say, as the text for those who cannot see it."""
    title = figure.get_suptitle() if hasattr(figure, "get_suptitle") else ""
    axes = getattr(figure, "axes", ())
    labels = [" ".join(filter(None, (a.get_title(loc="left"), a.get_ylabel() or a.get_xlabel()))) for a in axes]
    return title or ", ".join(dict.fromkeys(label for label in labels if label)) or "Figure"


_MAGIC = ((b"\x89PNG", "image/png"), (b"\xff\xd8", "image/jpeg"), (b"GIF8", "image/gif"), (b"<", "image/svg+xml"))


def _source(content: Figure | bytes | str | Path) -> str:
    """Return a picture as a data URL."""
    if isinstance(content, str):
        content = content.strip().encode() if content.lstrip().startswith("<") else Path(content)
    if isinstance(content, Path):
        content = _read(content)
    if not isinstance(content, bytes):
        from .plots import png

        if not hasattr(content, "savefig"):
            raise CraneError(
                f"A part of the report is {shortened(content)}. Give a text, a Table, a Picture, Links or a matplotlib "
                "figure."
            )
        content = png(content)
    kind = next((kind for magic, kind in _MAGIC if content.startswith(magic)), None)
    if kind is None:
        raise CraneError(f"A picture of the report starts with {content[:8]!r}: it is not PNG, JPEG, GIF or SVG.")
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as problem:
        raise CraneError(f"{path}: the picture for the report cannot be read ({problem.strerror}).") from problem
