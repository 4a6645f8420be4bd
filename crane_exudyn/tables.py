"""Columns as they stand in a file, before names, units and clocks are judged; and the reader of text files (CSV)."""

from __future__ import annotations

import csv
import io
import re
import warnings
import zlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from itertools import chain
from pathlib import Path
from typing import BinaryIO

import numpy as np

from .errors import CraneError

#: names that are told one by one
_FEW = 3
_NEWLINE = 10
#: bytes that are read and turned into numbers at a time, so that memory does not grow with the text
_PIECE = 8_000_000
#: what zlib wants to be told for gzip
_GZIP = 31
_UTF16 = (b"\xff\xfe", b"\xfe\xff")
#: what plain numbers are written with; anything else is for the careful reader
_PLAIN = b"0123456789+-.eEnNaA\n"
#: signs that no text has; 26 is how old programs end a file
_CONTROL = bytes({*range(32)} - {*b"\t\n\v\f\r\x1a\x1b"})
#: a date as in ISO 8601, with or without a time of day; hours, minutes and seconds; what else may be a date or time
_DATE, _OF_DAY = re.compile(r"\d{4}-\d\d-\d\d([T ].+)?"), re.compile(r"(\d+):([0-5]\d):([0-5]\d(?:[.,]\d*)?)")
_MAYBE_TIME = re.compile(r"\d+:\d+|\d+[-./]\d+[-./]\d+")
#: spreadsheets and archives that people hand over by mistake, by their first bytes
_NOT_TEXT = {
    b"PK": "an Excel or ZIP file",
    b"\xd0\xcf\x11\xe0": "an old Excel file",
    b"%PDF": "a PDF",
    b"\x89PNG": "a picture",
}


@dataclass(frozen=True)
class RawColumn:
    """One column of a file.

    Attributes:
        header: as it stands in the file, such as "z1[deg]".
        values: (n,) numbers in the file's unit, NaN where there is no sample.
        unit: where the format keeps units apart from names; None where the header tells, or nothing does.
        clock: the column that holds the times of `values`; None where the file has one `time` column for all.
    """

    header: str
    values: np.ndarray
    unit: str | None = None
    clock: RawColumn | None = None


@dataclass(frozen=True)
class RawTable:
    """A file's columns, how to name a place in it ("line 17"), and remarks on what was left out."""

    columns: Sequence[RawColumn]
    place: Callable[[int], str] = lambda row: f"sample {row + 1}"
    notes: Sequence[str] = field(default_factory=tuple)


def split_header(header: str) -> tuple[str, str | None]:
    """Return name and unit of "name[unit]"; unit None where there are no brackets."""
    name, bracket, rest = header.strip().rpartition("[")
    if not bracket or not rest.endswith("]"):
        return header.strip(), None
    return name.strip(), rest[:-1].strip()


def remarks(what: str, names: Sequence[str], happened: str) -> list[str]:
    """Return one remark a name where they are few, one for all where they are many, such as "column 'operator' was
    ignored".
    """
    if len(names) <= _FEW:
        return [f"{what} {name!r} {happened}" for name in names]
    return [f"{len(names)} {what}s such as {', '.join(map(repr, names[:_FEW]))}: each {happened}"]


# -- text files ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Form:
    """What a text file's header line tells: names, what separates fields, and how many lines stand above the data.

    Attributes:
        stamps: the first field of each column of dates or times of day, from which its seconds count.
        unasked: columns that nothing asks for; texts: those of them in which text was found while reading.
    """

    path: Path
    names: list[str]
    delimiter: str
    skipped: int
    stamps: Mapping[str, str] = field(default_factory=dict)
    unasked: Collection[str] = ()
    texts: set[str] = field(default_factory=set)

    @property
    def decimal_comma(self) -> bool:
        return self.delimiter != ","


def read_text(path: Path, file: BinaryIO, wanted: Collection[str]) -> RawTable:
    """Return the columns of a CSV file, read from `file` piece by piece; without those that hold text, unless their
    names are `wanted`.

    Fields are separated by commas, semicolons or tabs, as the header line shows; with the latter two, decimals may
    be commas. UTF-8 with or without byte order mark, UTF-16 and Windows-1252 are read, any line ends, and gzip. Lines
    above the header that start with # are skipped. Dates as in ISO 8601 ("2024-03-01 10:00:00.000") and times of day
    ("10:00:00.000") become seconds from the first.

    Raises:
        CraneError: empty or cut-off file, text in a number that is wanted, a line without any number, or with too few
            or too many fields.
    """
    pieces = _pieces(path, file)
    form, first = _header(path, next(pieces, b""))
    unasked = [name for name in form.names if name not in wanted and split_header(name)[0] not in wanted]
    form = replace(form, stamps=_stamps(form, first), unasked=unasked)
    line, numbers, lines = form.skipped + 2, [], []
    ahead: bytes | None = first
    while ahead is not None:
        body, ahead = ahead, next(pieces, None)
        values, own = _read(body, form, line, last=ahead is None)
        numbers.append(values)
        lines.append(own)
        line += body.count(b"\n")
    found = np.concatenate(numbers)
    if not len(found):
        raise CraneError(f"{path}: the file ends after its header line. Expected one line per sample; record again.")
    columns = [_column(name, found[:, i], form) for i, name in enumerate(form.names) if name and name not in form.texts]
    notes = [f"column {split_header(n)[0]!r} counts from {t}" for n, t in form.stamps.items() if n not in form.texts]
    notes += remarks("column", sorted(form.texts, key=form.names.index), "contains text, not numbers, and was ignored")
    return RawTable(columns, lambda row: f"line {np.concatenate(lines)[row]}", notes)


def _column(name: str, values: np.ndarray, form: Form) -> RawColumn:
    """Return a column; one of dates or times of day is in seconds, whatever its header says of their form."""
    return RawColumn(split_header(name)[0], values, "s") if name in form.stamps else RawColumn(name, values)


def _pieces(path: Path, file: BinaryIO) -> Iterator[bytes]:
    """Yield the content in pieces that end with a line, each line with a newline at its end."""
    rest, start = b"", True
    for read in _content(path, file):
        data = rest + (_decode(path, read) if start else _plain(path, read))
        cut = data.rfind(b"\n") + 1
        start, rest = False, data[cut:]
        if cut:
            yield _newlines(data[:cut])
    if rest:
        last = _newlines(rest)
        yield last if last.endswith(b"\n") else last + b"\n"


def _content(path: Path, file: BinaryIO) -> Iterator[bytes]:
    """Yield what is in a text file, unzipped where it is zipped; UTF-16 at once, for it is cut nowhere."""
    start = file.read(_PIECE)
    if start.startswith(b"\x1f\x8b"):
        yield from _unzipped(path, chain([start], iter(lambda: file.read(_PIECE), b"")))
    elif start.startswith(_UTF16):
        yield start + file.read()
    else:
        yield start
        yield from iter(lambda: file.read(_PIECE), b"")


def _unzipped(path: Path, pieces: Iterable[bytes]) -> Iterator[bytes]:
    """Yield what gzip members hold, no piece of it larger than a few megabytes."""
    unzip = zlib.decompressobj(_GZIP)
    try:
        for piece in pieces:
            data = piece
            while data:
                yield unzip.decompress(data, _PIECE)
                data = unzip.unconsumed_tail or unzip.unused_data
                if unzip.eof and data:
                    unzip = zlib.decompressobj(_GZIP)
        while not unzip.eof:
            rest = unzip.decompress(unzip.unconsumed_tail, _PIECE)
            if not rest:
                raise EOFError("it ends before its end mark")
            yield rest
    except (EOFError, zlib.error) as problem:
        raise CraneError(
            f"{path}: the gzip file is cut off or damaged ({problem}). Copy or export it again."
        ) from problem


def _decode(path: Path, data: bytes) -> bytes:
    """Return the beginning of a file without byte order mark, one byte per ASCII character."""
    for start, kind in _NOT_TEXT.items():
        if data.startswith(start):
            raise CraneError(f"{path}: this is {kind}, expected text. Export it as CSV.")
    if data.startswith(_UTF16):
        return data.decode("utf-16", errors="replace").encode()
    return _plain(path, data.removeprefix(b"\xef\xbb\xbf"))


def _plain(path: Path, data: bytes) -> bytes:
    if b"\x00" in data:
        raise CraneError(
            f"{path}: contains zero bytes, so it is a binary file, or a text file that was cut off while being "
            "written. Export it as CSV."
        )
    if len(data.translate(None, _CONTROL)) < len(data):
        raise CraneError(f"{path}: contains bytes that do not occur in text, so it is a binary file. Export it as CSV.")
    return data


def _newlines(data: bytes) -> bytes:
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data


def _header(path: Path, data: bytes) -> tuple[Form, bytes]:
    if not data.strip():
        raise CraneError(f"{path}: the file is empty. Expected a first line name[unit],… and one line per sample.")
    skipped = 0
    line, _, body = data.partition(b"\n")
    while not line.strip() or line.startswith(b"#"):
        skipped += 1
        line, newline, body = body.partition(b"\n")
        if not newline and not line.strip():
            raise CraneError(f"{path}: there is no header line. Expected a line name[unit],… and one line per sample.")
    text = _to_text(line)
    delimiter = _delimiter(text)
    names = [name.strip() for name in next(csv.reader([text], delimiter=delimiter))]
    _check_header(path, skipped + 1, names)
    return Form(path, names, delimiter, skipped), body


def _stamps(form: Form, body: bytes) -> dict[str, str]:
    """Return {column: first field} of the columns that begin with a date or a time of day."""
    line = _to_text(body.lstrip(b"\n").partition(b"\n")[0])
    fields = next(csv.reader([line], delimiter=form.delimiter), [])
    first = {name: text.strip() for name, text in zip(form.names, fields, strict=False) if name}
    return {name: text for name, text in first.items() if _is_stamp(text)}


def _is_stamp(text: str) -> bool:
    try:
        return _since(text, text) == 0.0
    except ValueError:
        return False


def _since(first: str, text: str) -> float:
    """Return the seconds from a first date to another, or from a first time of day.

    Raises:
        ValueError: one is neither, or they are not of one kind.
    """
    times = [_OF_DAY.fullmatch(t) for t in (first, text)]
    if times[0] and times[1]:
        start, now = (60.0 * (60.0 * float(t[1]) + float(t[2])) + float(t[3].replace(",", ".")) for t in times if t)
        return round(now - start, 9)
    if not (_DATE.fullmatch(first) and _DATE.fullmatch(text)):
        raise ValueError
    try:
        return (datetime.fromisoformat(text) - datetime.fromisoformat(first)).total_seconds()
    except TypeError:  # one knows its time zone, the other does not
        raise ValueError from None


def _to_text(line: bytes) -> str:
    try:
        return line.decode("utf-8")
    except UnicodeDecodeError:
        return line.decode("cp1252", errors="replace")


def _delimiter(header: str) -> str:
    bare = "".join(part.partition("]")[2] if i else part for i, part in enumerate(header.split("[")))
    return next((d for d in (";", "\t") if d in bare), ",")


def _check_header(path: Path, line: int, names: list[str]) -> None:
    place = f"{path}, line {line}"
    if all(_is_number(name) for name in names if name):
        raise CraneError(
            f"{place}: found numbers, expected the header name[unit],… such as time[s],u1,u2,z1[deg]. Add it."
        )
    if len(names) == 1:
        raise CraneError(
            f"{place}: found the single column {names[0][:60]!r}, expected several, separated by commas, semicolons "
            "or tabs. Export the file with one of these."
        )


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def _read(body: bytes, form: Form, line: int, last: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return numbers (n, columns) and line numbers (n,) of some lines, of which the first has the number `line`."""
    values = read_fast(body, form) if body.strip() else np.empty((0, len(form.names)))
    if values is None:
        return read_carefully(body, form, line, last)
    return values, np.arange(line, line + len(values), dtype=np.int32)


def read_fast(body: bytes, form: Form) -> np.ndarray | None:
    """Return the numbers (rows, columns), or None where the body is not plain and wants the careful reader."""
    separator = form.delimiter.encode()
    body = body.rstrip(b"\n") + b"\n"
    body = _without_spaces(body, separator)
    if body.translate(None, _PLAIN + separator + b"," * form.decimal_comma) or b"\n\n" in b"\n" + body:
        return None
    rows = _count_rows(body, ord(separator), len(form.names))
    if rows is None:
        return None
    if form.decimal_comma:
        body = body.replace(b",", b".")
    flat = _fill_empty(body, separator).replace(b"\n", separator)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            numbers = np.fromstring(flat.decode("ascii", errors="replace"), sep=form.delimiter)  # type: ignore[call-overload]
        except (DeprecationWarning, ValueError):
            return None
    if numbers.size != rows * len(form.names):
        return None
    numbers = numbers.reshape(rows, -1)
    return None if np.isnan(numbers).all(axis=1).any() else numbers


def _without_spaces(body: bytes, separator: bytes) -> bytes:
    """Return `body` without spaces beside separators; numpy would read a field of spaces as -1."""
    while b" " + separator in body or separator + b" " in body:
        body = body.replace(b" " + separator, separator).replace(separator + b" ", separator)
    while b" \n" in body or b"\n " in body:
        body = body.replace(b" \n", b"\n").replace(b"\n ", b"\n")
    return body


def _count_rows(body: bytes, separator: int, columns: int) -> int | None:
    """Return the number of lines, or None unless each has as many fields as the header."""
    characters = np.frombuffer(body, dtype=np.uint8)
    ends = np.flatnonzero(characters == _NEWLINE)
    separators = np.searchsorted(np.flatnonzero(characters == separator), ends)
    return len(ends) if np.all(np.diff(separators, prepend=0) == columns - 1) else None


def _fill_empty(body: bytes, separator: bytes) -> bytes:
    """Return `body` with nan in its empty fields."""
    double = separator + separator
    if double in body:
        body = body.replace(double, separator + b"nan" + separator).replace(double, separator + b"nan" + separator)
    body = body.replace(separator + b"\n", separator + b"nan\n").replace(b"\n" + separator, b"\nnan" + separator)
    return b"nan" + body if body.startswith(separator) else body


def read_carefully(body: bytes, form: Form, first: int, last: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return numbers and line numbers, reading field by field; this is what finds and names a fault."""
    rows, lines = [], []
    text = _to_text(body)
    reader = csv.reader(io.StringIO(text), delimiter=form.delimiter)
    total = text.count("\n") + (not text.endswith("\n"))
    for fields in reader:
        if not any(field.strip() for field in fields):
            continue
        line = first - 1 + reader.line_num
        _check_length(fields, form, line, last=last and reader.line_num >= total)
        rows.append([_number(field, name, form, line) for field, name in zip(fields, form.names, strict=False)])
        if form.texts:
            _check_numbers(rows[-1], fields, form, line)
        lines.append(line)
    return np.array(rows, dtype=float).reshape(-1, len(form.names)), np.array(lines, dtype=np.int32)


def _check_length(fields: list[str], form: Form, line: int, last: bool) -> None:
    found, expected = len(fields), len(form.names)
    if found == expected or (found > expected and not any(f.strip() for f in fields[expected:])):
        return
    what = f"{form.path}, line {line}: found {found} fields, expected {expected} as in the header."
    if found < expected and last:
        raise CraneError(f"{what} The file was cut off in its last line. Delete that line, or export the file again.")
    if found > expected and form.delimiter == ",":
        raise CraneError(f"{what} If decimals are commas, separate the fields by semicolons. Otherwise correct it.")
    raise CraneError(f"{what} Correct that line; an empty field is a missing sample.")


def _number(field: str, name: str, form: Form, line: int) -> float:
    text = field.strip()
    if not text or not name or name in form.texts:
        return np.nan
    try:
        if name in form.stamps:
            return _since(form.stamps[name], text)
        if "_" in text:  # Python's float takes 1_000, nobody's logger writes it
            raise ValueError
        return float(text.replace(",", ".") if form.decimal_comma else text)
    except ValueError:
        if name in form.unasked:
            form.texts.add(name)
            return np.nan
        raise CraneError(_no_number(text, name, form, line)) from None


def _check_numbers(numbers: list[float], fields: list[str], form: Form, line: int) -> None:
    """Refuse a line of text without a number, as one of units is, whatever is asked for."""
    said = [(f.strip(), n) for f, n in zip(fields, form.names, strict=False) if n in form.texts and f.strip()]
    if said and np.isnan(numbers).all():
        raise CraneError(_no_number(*said[0], form, line))


def _no_number(text: str, name: str, form: Form, line: int) -> str:
    """Return what to say of a field that is neither a number nor a date as the first of its column."""
    where = f"{form.path}, line {line}, column {name[:40]}: found {text[:40]!r}"
    if name in form.stamps:
        return f"{where}, expected a time such as {form.stamps[name]} in the column's first line. Correct it."
    if _MAYBE_TIME.search(text):
        return (
            f"{where}, expected a number. It looks like a date or a time: export seconds, or in every line "
            "2024-03-01 10:00:00.000 or 10:00:00.000, which are read as seconds from the first."
        )
    hint = " If this line holds units, put them into the header, as name[unit]." if line <= form.skipped + 2 else ""
    return f"{where}, expected a number. Correct it, or leave the field empty for a missing sample.{hint}"
