"""File formats at the edge: which reader a file wants, and writers for what leaves.

How names and units are found:

- CSV: the header `name[unit]`.
- MATLAB (v5 and v7.3): one vector a channel, named as the channel. Its unit stands in `units.NAME` (a struct) or in
  `NAME_unit`; its times in `NAME_time`, or in `time` for all. Or one struct a channel, with `values` (or `data`),
  `unit` (or `units`) and, if it has its own clock, `time` in s. All of it may lie in one struct of any name.
- Parquet: columns `name[unit]`, or the unit in the field's metadata under `unit`. Time stamps count from the first.
- MDF4: channel name and unit as stored, each with the clock of its group. Needs the optional asammdf.
"""

from __future__ import annotations

import gc
import gzip
import importlib
import re
import sys
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .errors import CraneError, named_file
from .files import replacing
from .tables import RawColumn, RawTable, read_text, remarks, split_header

Writer = Callable[[Path, Mapping[str, np.ndarray], int | None], None]
#: lines of a text file that are written at a time
_LINES = 10_000
#: groups within groups, characters of a text, and numbers of a channel that a MATLAB file may have
_DEEPEST, _LONGEST_TEXT, _MOST_NUMBERS = 10, 10_000, 200_000_000
_VALUES, _UNIT = ("values", "data", "Data"), ("unit", "units", "Unit")


def read(path: Path, wanted: Collection[str]) -> RawTable:
    """Return the columns of a recording file; its first bytes tell the format.

    Args:
        path: the file.
        wanted: names that matter; formats with thousands of channels read only these, and text in others is ignored.
    """
    if path.is_dir():
        raise CraneError(f"{path} is a folder, expected a recording file.")
    try:
        with path.open("rb") as file:
            head = file.peek(_HEAD)[:_HEAD]
            reader = next((r for start, r in _READERS.items() if head.startswith(start)), None)
            if reader is None and path.suffix.lower() not in (".mat", ".parquet", ".mf4", ".mdf"):
                return read_text(path, file, wanted)
    except FileNotFoundError:
        raise CraneError(f"{path}: there is no such file. Check the name and the folder.") from None
    if reader is None:
        raise CraneError(f"{path}: the content is not that of a {path.suffix} file; it is empty, cut off or misnamed.")
    return reader(path, wanted)


# -- MATLAB ----------------------------------------------------------------------------------------------------------


def _read_mat5(path: Path, _: Collection[str]) -> RawTable:
    from scipy.io import loadmat

    try:
        content = loadmat(path, squeeze_me=True, struct_as_record=False, chars_as_strings=True)
    except Exception as problem:  # scipy raises many kinds for a damaged file
        raise CraneError(f"{path}: damaged or cut-off MATLAB file ({problem}). Save it again.") from problem
    return _from_variables(path, {k: _plain(v) for k, v in content.items() if not k.startswith("__")})


def _plain(value: Any) -> Any:
    """Return a MATLAB struct as a dict, text as str, numbers as they are, anything else as `Unread`."""
    fields = getattr(value, "_fieldnames", None)  # scipy's name for it
    if fields is not None:
        return {name: _plain(getattr(value, name)) for name in fields}
    if isinstance(value, str):
        return str(value)
    if isinstance(value, np.ndarray) and value.dtype.kind in "OUS":
        return Unread("is a cell array" if value.dtype == object else "is text")
    return value


@dataclass(frozen=True)
class Unread:
    """What stands in a file in the place of a channel but holds no numbers: why, such as "is text"."""

    why: str


def _read_mat73(path: Path, _: Collection[str]) -> RawTable:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return _from_variables(path, _hdf5_group(file))
    except (OSError, RuntimeError) as problem:
        raise CraneError(f"{path}: damaged or cut-off MATLAB v7.3 file ({problem}). Save it again.") from problem


def _hdf5_group(group: Any, depth: int = 0) -> dict[str, Any]:
    """Return what a group holds: arrays, text, groups as dicts; `Unread` for links that lead nowhere, and what is no
    number.
    """
    return {name: _hdf5_item(group, name, depth) for name in group if not name.startswith("#")}  # # is MATLAB's own


def _hdf5_item(group: Any, name: str, depth: int) -> Any:
    import h5py

    if isinstance(group.get(name, getlink=True), h5py.ExternalLink):
        return Unread("is a link to another file")
    try:
        item = group[name]
    except (KeyError, OSError):
        return Unread("is a link that leads nowhere")
    if isinstance(item, h5py.Group):
        return _hdf5_group(item, depth + 1) if depth < _DEEPEST else Unread("lies too deep in other groups")
    return _hdf5_dataset(item) if isinstance(item, h5py.Dataset) else Unread("is not a data set")


def _hdf5_dataset(item: Any) -> Any:
    """Return the numbers of a data set, or its text; `Unread` for what is neither, or no vector, or larger than any
    recording.
    """
    if item.dtype.fields is not None:
        return Unread("is compound")
    if item.attrs.get("MATLAB_class") == b"char" and item.dtype.kind in "iu" and item.size <= _LONGEST_TEXT:
        return "".join(map(chr, np.ravel(item[()], order="F").astype(np.uint16).tolist()))
    if item.dtype.kind not in "fiub":
        return Unread(
            "is a cell array" if item.dtype.hasobject and item.attrs.get("MATLAB_class") == b"cell" else "is text"
        )
    if item.shape is None or "MATLAB_empty" in item.attrs:
        return Unread("is empty")
    if item.size > _MOST_NUMBERS:
        return Unread(f"has {item.size:.3g} numbers, more than any recording")
    return np.squeeze(item[()])


def _from_variables(path: Path, variables: Mapping[str, Any]) -> RawTable:
    """Return the columns that MATLAB variables make."""
    variables = _unwrap(variables)
    columns: list[RawColumn] = []
    strange: dict[str, list[str]] = {}
    clocks: dict[str, RawColumn] = {}
    for name, value in variables.items():
        if _is_channel(value):
            columns.append(_struct_column(path, name, value))
        elif _is_vector(value):
            own = _own_clock(path, name, variables, clocks)
            columns.append(RawColumn(name, np.asarray(value, dtype=float).ravel(), _unit_of(name, variables), own))
        elif name not in _UNIT and not name.endswith("_unit"):
            strange.setdefault(_why(value), []).append(name)
    notes = [note for why, names in strange.items() for note in remarks("variable", names, f"{why} and was ignored")]
    if not columns:
        raise CraneError(
            f"{path}: found no vector of numbers, expected one a channel, named as the channel (z1, p1, …)."
            + (f" ({'; '.join(notes[:3])}.)" if notes else "")
        )
    return RawTable(columns, notes=notes)


def _why(value: Any) -> str:
    """Return why a variable makes no channel."""
    if isinstance(value, Unread):
        return value.why
    return "is text" if isinstance(value, str) else "is neither a vector nor a struct with values"


def _unwrap(variables: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the content of the one struct that holds everything beside what stands there, or `variables` where there
    is no such struct.
    """
    structs = {k: v for k, v in variables.items() if isinstance(v, Mapping) and not _is_channel(v)}
    others = [v for v in variables.values() if _is_channel(v) or _is_vector(v)]
    if len(structs) != 1 or others:
        return variables
    return {k: v for k, v in variables.items() if k not in structs} | dict(next(iter(structs.values())))


def _is_channel(value: Any) -> bool:
    return isinstance(value, Mapping) and any(_is_vector(value.get(key)) for key in _VALUES)


def _is_vector(value: Any) -> bool:
    if isinstance(value, Mapping | str | Unread) or value is None:
        return False
    array = np.asarray(value)
    return array.dtype.kind in "fiub" and array.ndim == 1


def _struct_column(path: Path, name: str, struct: Mapping[str, Any]) -> RawColumn:
    values = next(struct[key] for key in _VALUES if _is_vector(struct.get(key)))
    unit = next((str(struct[key]) for key in _UNIT if isinstance(struct.get(key), str)), None)
    clock = None
    if "time" in struct:
        unit_of_time = struct.get("time_unit", "s")
        clock = _clock(path, f"{name}.time", struct["time"], unit_of_time if isinstance(unit_of_time, str) else None)
    return RawColumn(name, np.asarray(values, dtype=float).ravel(), unit, clock)


def _clock(path: Path, name: str, values: Any, unit: str | None) -> RawColumn:
    if not _is_vector(values):
        raise CraneError(f"{path}, {name}: {_why(values)}, expected a vector of times in s. Save the times as numbers.")
    return RawColumn(name, np.asarray(values, dtype=float).ravel(), unit)


def _unit_of(name: str, variables: Mapping[str, Any]) -> str | None:
    table: Mapping[str, Any] = next((variables[key] for key in _UNIT if isinstance(variables.get(key), Mapping)), {})
    unit = table.get(name, variables.get(f"{name}_unit"))
    return unit if isinstance(unit, str) else None


def _own_clock(path: Path, name: str, variables: Mapping[str, Any], clocks: dict[str, RawColumn]) -> RawColumn | None:
    key = f"{name}_time"
    if key in variables and key not in clocks:
        clocks[key] = _clock(path, key, variables[key], _unit_of(key, variables))
    return clocks.get(key)


# -- Parquet ---------------------------------------------------------------------------------------------------------


def _read_parquet(path: Path, _: Collection[str]) -> RawTable:
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns: list[RawColumn] = []
    strange: dict[str, list[str]] = {}
    try:
        file = pq.ParquetFile(path)
        if file.metadata.num_rows > _MOST_NUMBERS:
            raise CraneError(f"{path}: has {file.metadata.num_rows:.3g} rows, more than any recording. Cut it.")
        for entry, column in zip(file.schema_arrow, file.read().columns, strict=True):
            values, own_unit = _arrow_numbers(column)
            if values is None:
                strange.setdefault(f"contains {entry.type}, not numbers,", []).append(entry.name)
            else:
                columns.append(RawColumn(entry.name, values, own_unit or _arrow_unit(entry.metadata or {})))
    except (pa.ArrowException, OSError) as problem:
        raise CraneError(f"{path}: damaged or cut-off Parquet file ({problem}). Write it again.") from problem
    notes = [note for why, names in strange.items() for note in remarks("column", names, f"{why} and was ignored")]
    return RawTable(columns, lambda row: f"row {row + 1}", notes)


def _arrow_unit(metadata: Mapping[bytes, bytes]) -> str | None:
    unit = metadata.get(b"unit", metadata.get(b"units"))
    return unit.decode("utf-8", errors="replace") if unit else None


def _arrow_numbers(column: Any) -> tuple[np.ndarray | None, str | None]:
    """Return a column as floats with NaN for null, and its unit where the type itself is a time."""
    import pyarrow as pa

    kind = column.type
    if pa.types.is_timestamp(kind) or pa.types.is_duration(kind):
        stamps = np.asarray(column.to_numpy())
        since = stamps - stamps[0] if pa.types.is_timestamp(kind) and len(stamps) else stamps
        return since / np.timedelta64(1, "s"), "s"
    if pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_decimal(kind):
        return np.asarray(column.cast(pa.float64()).to_numpy(), dtype=float), None
    return None, None


# -- MDF4 ------------------------------------------------------------------------------------------------------------


def _read_mdf(path: Path, wanted: Collection[str]) -> RawTable:
    try:
        mdf = importlib.import_module("asammdf").MDF
    except ImportError:
        raise CraneError(
            f"{path}: reading MDF files needs asammdf, which is not installed. Install it: pip install asammdf."
        ) from None
    signals, others = _mdf_content(mdf, path, wanted)
    clocks: dict[bytes, RawColumn] = {}
    columns = []
    for signal in signals:
        stamps = np.asarray(signal.timestamps, dtype=float)
        clock = clocks.setdefault(stamps.tobytes(), RawColumn(f"time of {signal.name}", stamps, "s"))
        columns.append(RawColumn(signal.name, np.asarray(signal.samples, dtype=float), signal.unit or None, clock))
    if not columns:
        columns = [RawColumn(name, np.empty(0)) for name in others[:20]]
    return RawTable(columns, notes=[f"{len(others)} other channels were ignored"] if others else [])


def _mdf_content(mdf: Any, path: Path, wanted: Collection[str]) -> tuple[list[Any], list[str]]:
    """Return the wanted signals and the names of the others."""
    try:
        with mdf(path) as file:
            signals = list(_mdf_signals(file, wanted))
            return signals, sorted(set(file.channels_db) - {"time", "t"} - {s.name for s in signals})
    except Exception as problem:  # asammdf raises many kinds for a damaged file
        text = f"{path}: damaged or cut-off MDF file ({problem}). Save it again."
    with _finalisers_kept_quiet():  # asammdf's half-made object fails once more when it is deleted
        gc.collect()
    raise CraneError(text)


@contextmanager
def _finalisers_kept_quiet() -> Iterator[None]:
    usual = sys.unraisablehook
    sys.unraisablehook = lambda _: None
    try:
        yield
    finally:
        sys.unraisablehook = usual


def _mdf_signals(file: Any, wanted: Collection[str]) -> Iterator[Any]:
    """Yield the wanted signals, but for the groups' own clocks, which come with every signal."""
    for name, places in file.channels_db.items():
        if name in wanted or split_header(name)[0] in wanted:
            for group, index in (p for p in places if file.masters_db.get(p[0]) != p[1]):
                signal = file.get(name, group=group, index=index)
                if signal.samples.ndim == 1 and signal.samples.dtype.kind in "fiub":
                    yield signal


#: how a file begins that is no text, and what reads it
_READERS: dict[bytes, Callable[[Path, Collection[str]], RawTable]] = {
    b"MATLAB 5.0": _read_mat5,
    b"MATLAB 7.3": _read_mat73,
    b"\x89HDF\r\n\x1a\n": _read_mat73,
    b"PAR1": _read_parquet,
    b"MDF ": _read_mdf,
    b"UnFinMF ": _read_mdf,
}
_HEAD = 16


# -- writers ---------------------------------------------------------------------------------------------------------


def write_table(path: str | Path, columns: Mapping[str, np.ndarray], digits: int | None = None) -> None:
    """Write columns of equal length to .csv, .csv.gz, .parquet or .mat, whole or not at all.

    Args:
        path: its ending chooses the format.
        columns: "name[unit]" -> (n,) values, NaN is a missing sample; or (n,) texts.
        digits: significant digits in text files; by default as many as read back the same number.
    """
    write = writer_of(path)
    with replacing(path) as temporary:
        write(temporary, columns, digits)


def data_frame(time: np.ndarray, columns: Mapping[str, np.ndarray], units: Mapping[str, str]) -> Any:
    """Return columns (n,) over time (n,) in s as a pandas DataFrame; SI, the unit of each column stands in
    `attrs["units"]`, which pandas does not write into text files.

    Raises:
        CraneError: pandas is not installed.
    """
    try:
        import pandas
    except ImportError as problem:
        raise CraneError("A data frame needs pandas. Install it: pip install pandas.") from problem
    frame = pandas.DataFrame(dict(columns), index=pandas.Index(time, name="time"))
    frame.attrs["units"] = {"time": "s"} | {name: units.get(name, "") for name in columns}
    return frame


def writer_of(path: str | Path) -> Writer:
    """Return the writer for the ending of `path`; commands ask for it before they begin to work.

    Raises:
        CraneError: an ending without a writer.
    """
    target = named_file(path, "save")
    for ending, write in _WRITERS.items():
        if target.name.lower().endswith(ending):
            return write
    known = ", ".join(_WRITERS)
    raise CraneError(f"{target}: cannot write {target.suffix or 'a file without ending'!r}. Known: {known}.")


def _csv_pieces(columns: Mapping[str, np.ndarray], digits: int | None) -> Iterator[bytes]:
    """Yield the columns as CSV, missing samples empty, some lines at a time: text is many times larger than numbers."""
    text: Callable[[float], str] = repr if digits is None else f"{{:.{digits}g}}".format
    yield (",".join(columns) + "\n").encode()
    length = {len(v) for v in columns.values()}
    for first in range(0, max(length, default=0), _LINES):
        some = [v[first : first + _LINES] for v in columns.values()]
        fields = [_quoted(v) if _is_text(v) else _numbers(v, text) for v in some]
        yield ("\n".join(map(",".join, zip(*fields, strict=True))) + "\n").encode()


def _numbers(values: np.ndarray, text: Callable[[float], str]) -> list[str]:
    return ["" if x != x else text(x) for x in np.asarray(values, dtype=float).tolist()]


def _quoted(values: np.ndarray) -> list[str]:
    """Return texts as CSV fields, in quotes where they hold what separates fields or lines."""
    plain = [str(v) for v in values]
    return ['"' + v.replace('"', '""') + '"' if re.search(r'[",;\n]', v) else v for v in plain]


def _is_text(values: np.ndarray) -> bool:
    return np.asarray(values).dtype.kind in "US"


def _array(values: np.ndarray) -> np.ndarray:
    """Return numbers as floats, texts as objects."""
    return np.asarray(values, dtype=object if _is_text(values) else float)


def _write_csv(path: Path, columns: Mapping[str, np.ndarray], digits: int | None) -> None:
    with path.open("wb") as file:
        file.writelines(_csv_pieces(columns, digits))


def _write_csv_gz(path: Path, columns: Mapping[str, np.ndarray], digits: int | None) -> None:
    with path.open("wb") as raw, gzip.GzipFile("", "wb", compresslevel=5, fileobj=raw, mtime=0) as file:
        file.writelines(_csv_pieces(columns, digits))


def _write_parquet(path: Path, columns: Mapping[str, np.ndarray], digits: int | None) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table({name: pa.array(_array(v)) for name, v in columns.items()}), path)


def _write_mat(path: Path, columns: Mapping[str, np.ndarray], digits: int | None) -> None:
    """Write one vector a column and the struct `units`; MATLAB's names have no dots, so payload.mass is
    payload_mass.
    """
    from scipy.io import savemat

    content: dict[str, Any] = {}
    units = {}
    for header, values in columns.items():
        name, unit = split_header(header)
        name = re.sub(r"\W", "_", name)
        content[name], units[name] = _array(values).reshape(-1, 1), unit or "-"
    savemat(path, content | {"units": units}, do_compression=True, long_field_names=True)


_WRITERS: dict[str, Writer] = {
    ".csv": _write_csv,
    ".csv.gz": _write_csv_gz,
    ".parquet": _write_parquet,
    ".mat": _write_mat,
}
