"""Mutated recordings, crane files and command lines: an answer or one message, never a fault, never a lost or
half-written file.

Every case follows from its kind and its number alone, so that one that fails can be run again. PATU_FUZZ_FIRST and
PATU_FUZZ_COUNT choose other numbers than those of the suite.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import os
import random
import re
import tempfile
import time
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

from crane_exudyn import Crane, Recording, simulate
from crane_exudyn.errors import CraneError
from patu import main
from ukf.estimator import Estimator
from validation.semi_recursive import SemiRecursiveEngine

FIRST, COUNT = int(os.environ.get("PATU_FUZZ_FIRST", "0")), int(os.environ.get("PATU_FUZZ_COUNT", "0"))
SAMPLES, STEP = 24, 0.01
#: a case that takes longer is a hang
LONGEST = 20.0
FAST = ("--engine", "semi-recursive")
Clean = dict[tuple[str, ...], dict[str, object]]
#: fields of a CSV that no logger should write, or that only some readers understand
FIELDS = (
    "", " ", "NaN", "nan", "inf", "-inf", "1e308", "-1e308", "1e400", "-0", "abc", "1,5", "0x10", "1_000", "١", "−5",
    "--5", "1e",
    "null", "#N/A", "true", '"3.5"', '"', "1.5.3", "1 000", "9" * 400, "1e-320", "\x00", "=1+1", "2026-01-01T00:00:00",
)  # fmt: skip
UNITS = (
    "", "bar", "°", "deg", "rad", "Grad", "furlong", "psi", "ms", "h", "1/0", "9**9**9", "deg*inf", "Pa**-1", "[deg",
    "deg]", "%", "-",
    "degC", "s]s[", "m/s", "1e400 bar", "dB", "mrad", "kPa", "min", "ns", "year", "0 bar", "-1 s", "nan bar",
)  # fmt: skip
NAMES = (
    "",
    "z1",
    "z4",
    "U1",
    "U2",
    "time",
    "Time",
    "t",
    "p1",
    "p9",
    "pp",
    "pt",
    "s1",
    "dz1",
    "z4_abs",
    "comment",
    "q[",
    "ż1",
    "a,b",
)


class Case(NamedTuple):
    """A command line, the input that is odd, and whether its result must be that of the sound one."""

    words: tuple[str, ...]
    odd: str = ""
    same: bool = False


@pytest.fixture(scope="module")
def sound() -> dict[str, np.ndarray]:
    """The columns of a short recording in the units of its header: a lift begins."""
    crane = Crane.load("patu655")
    clock = STEP * np.arange(SAMPLES)
    inputs = Recording.from_arrays("r", clock, {"u1": np.where(clock > 0.05, 0.3, 0.0), "u2": 0.0 * clock})
    run, noise = simulate(crane, inputs, engine=SemiRecursiveEngine(crane)), np.random.default_rng(1)
    columns = {"time[s]": clock, "u1": run["u1"], "u2": run["u2"]}
    columns |= {f"{n}[deg]": np.degrees(run[n]) + 0.01 * noise.standard_normal(SAMPLES) for n in ("z1", "z4")}
    return columns | {
        f"{n}[bar]": run[n] / 1e5 + 0.1 * noise.standard_normal(SAMPLES) for n in ("p1", "p2", "p3", "p4")
    }


# -- recordings ------------------------------------------------------------------------------------------------------


class Table:
    """A CSV in the making: header, rows of text, and what its bytes will be."""

    def __init__(self, columns: dict[str, np.ndarray]) -> None:
        self.names = list(columns)
        self.rows = [[f"{v:.6g}" for v in row] for row in zip(*columns.values(), strict=True)]
        self.delimiter, self.newline, self.same = ",", "\n", True

    def text(self) -> str:
        lines = [self.delimiter.join(self.names), *(self.delimiter.join(row) for row in self.rows)]
        return self.newline.join(lines) + self.newline

    def column(self, name: str) -> int:
        """Return where a column stands, or the first one if it is gone."""
        return next((i for i, n in enumerate(self.names) if n.startswith(name)), 0)

    def scaled(self, column: int, change: Callable[[float], float]) -> None:
        for row in self.rows:
            try:
                row[column] = f"{change(float(row[column])):.6g}"
            except (ValueError, IndexError, OverflowError):
                continue


def _fill(table: Table, draw: random.Random) -> None:
    """Put an odd field into one place, a run of them, or a whole column."""
    field, column = draw.choice(FIELDS), draw.randrange(len(table.names))
    first = draw.randrange(max(1, len(table.rows)))
    for row in table.rows[first : first + draw.choice((1, 3, SAMPLES))]:
        if column < len(row):
            row[column] = field


def _drop(table: Table, draw: random.Random) -> None:
    for _ in range(min(draw.choice((1, 1, 2, 6, 8)), len(table.names) - 1)):
        gone = draw.randrange(len(table.names))
        del table.names[gone]
        table.rows = [row[:gone] + row[gone + 1 :] for row in table.rows]


def _add(table: Table, draw: random.Random) -> None:
    name, field = draw.choice(NAMES), draw.choice((*FIELDS, "1", "0.5"))
    table.names.append(name + draw.choice(("", f"[{draw.choice(UNITS)}]")))
    for row in table.rows:
        row.append(field)


def _unit(table: Table, draw: random.Random) -> None:
    column = draw.randrange(len(table.names))
    table.names[column] = f"{table.names[column].partition('[')[0]}[{draw.choice(UNITS)}]"


def _rename(table: Table, draw: random.Random) -> None:
    column = draw.randrange(len(table.names))
    table.names[column] = draw.choice(
        (*NAMES, table.names[column].upper(), f'"{table.names[column]}"', "0", "z1[deg][deg]")
    )


def _scale(table: Table, draw: random.Random) -> None:
    factor, offset = draw.choice((1e6, 1e-6, -1.0, 0.0, 57.3, 1e12, 1.0)), draw.choice((0.0, 0.0, 1e5, -300.0))
    table.scaled(draw.randrange(len(table.names)), lambda v: factor * v + offset)


def _clock(table: Table, draw: random.Random) -> None:
    """Make the clock jump, stand still, run backwards, or start elsewhere."""
    column, at = table.column("time"), draw.randrange(1, SAMPLES)
    jump = draw.choice((1e9, 3600.0, 10.0, -0.05, -1e9, 1e300, 0.004))
    change = draw.choice(
        (
            lambda v: v + jump * (v >= at * STEP - 1e-9), lambda v: at * STEP, lambda v: -v, lambda v: v + jump,
            lambda v: v * jump,
            lambda v: round(v, 1), lambda v: v + 1.7e9, lambda v: min(v, at * STEP),
        )
    )  # fmt: skip
    table.scaled(column, change)


def _rows(table: Table, draw: random.Random) -> None:
    """Shuffle, double, reverse or cut the rows."""
    at = draw.randrange(max(1, len(table.rows)))
    what = draw.randrange(6)
    if what == 0:
        draw.shuffle(table.rows)
    elif what == 1:
        table.rows[at:at] = [list(row) for row in table.rows[at : at + draw.choice((1, 5, SAMPLES))]]
    elif what == 2:
        table.rows.reverse()
    elif what == 3:
        table.rows = table.rows[: draw.choice((0, 1, 2, 3))]
    elif table.rows:
        table.rows[at] = table.rows[at][: draw.randrange(3)] if what == 4 else [*table.rows[at], "1", "2"]


SPOIL = (_fill, _fill, _drop, _add, _unit, _rename, _scale, _clock, _rows)


def _reordered(table: Table, draw: random.Random) -> None:
    order = list(range(len(table.names)))
    draw.shuffle(order)
    table.names = [table.names[i] for i in order]
    table.rows = [[row[i] for i in order] for row in table.rows]


def _other_units(table: Table, draw: random.Random) -> None:
    for name, unit, factor in (("time", "ms", 1e3), ("z1", "mrad", 1e3 * np.pi / 180), ("p1", "kPa", 100.0)):
        column = table.column(name)
        table.names[column] = f"{name}[{unit}]"
        for row in table.rows:
            row[column] = repr(float(row[column]) * factor)


def _decimal_commas(table: Table, _: random.Random) -> None:
    table.delimiter, table.rows = ";", [[field.replace(".", ",") for field in row] for row in table.rows]


def _other_newline(table: Table, _: random.Random) -> None:
    table.newline = "\r\n"


def _quoted(table: Table, _: random.Random) -> None:
    table.names = [f'"{name}"' for name in table.names]
    table.rows = [[f'"{field}"' for field in row] for row in table.rows]


def _remark(table: Table, _: random.Random) -> None:
    table.names.append("remark")
    for row in table.rows:
        row.append("")


def _tabs(table: Table, _: random.Random) -> None:
    table.delimiter = "\t"


#: other ways to write the same recording, in the order in which they can be taken together
KEEP = (_reordered, _other_units, _decimal_commas, _other_newline, _quoted, _remark, _tabs)


def _bytes(text: str, draw: random.Random) -> bytes:
    """Return a text as bytes that are cut, mixed with noise or encoded otherwise."""
    data = bytearray(text.encode("utf-8", errors="replace"))
    at = draw.randrange(max(1, len(data)))
    what = draw.randrange(14)
    if what == 0:
        return b""
    if what == 1:
        return bytes(data[:at])
    if what in (2, 3):
        for _ in range(draw.choice((1, 4, 200))):
            data[draw.randrange(len(data))] = draw.randrange(256)
        return bytes(data)
    if what == 4:
        return draw.randbytes(draw.choice((1, 100, 5000)))
    if what == 5:
        return text.encode("utf-16")
    if what == 6:
        return bytes(data).replace(b"\n", b"\r")
    if what == 7:
        return (
            draw.choice(
                (
                    b"MATLAB 5.0 MAT-file",
                    b"MATLAB 7.3",
                    b"\x89HDF\r\n\x1a\n",
                    b"PAR1",
                    b"MDF     ",
                    b"\x1f\x8b",
                    b"UnFinMF ",
                )
            )
            + data
        )
    if what == 8:
        return gzip.compress(bytes(data))[: draw.choice((1, 10, 11, 100, -1, -8))]
    if what == 9:
        packed = bytearray(gzip.compress(bytes(data)))
        packed[draw.randrange(10, len(packed))] ^= 0x55
        return bytes(packed)
    if what == 10:
        return b"\n" * draw.choice((1, 50)) + draw.choice((b"", b"# remark\n")) + data
    if what == 11:
        return bytes(data[:at]) + b"\x00" * draw.choice((1, 4096)) + data[at:]
    if what == 12:
        return bytes(data).partition(b"\n")[draw.choice((0, 2))]
    return bytes(data[:at]) + b"," * draw.choice((1, 100_000)) + data[at:]


def _wrapped(text: str, draw: random.Random) -> bytes:
    """Return a text as bytes that hold the same."""
    data = text.encode()
    return draw.choice(
        (data, b"\xef\xbb\xbf" + data, gzip.compress(data), data.rstrip(b"\r\n"), b"# made by hand\n\n" + data)
    )


def recording_case(columns: dict[str, np.ndarray], draw: random.Random) -> Case:
    """Write an odd recording, and return what is done with it."""
    table, same = Table(columns), draw.random() < 0.2
    if same:
        for change in sorted(draw.sample(KEEP, draw.choice((1, 1, 2))), key=KEEP.index):
            change(table, draw)
        if table.delimiter == "\t":  # decimal commas want semicolons
            table.rows = [[field.replace(",", ".") for field in row] for row in table.rows]
        data = _wrapped(table.text(), draw)
    else:
        for _ in range(draw.choice((1, 1, 2, 3))):
            draw.choice(SPOIL)(table, draw)
        data = table.text().encode("utf-8", errors="replace")
        if draw.random() < 0.3:
            data = _bytes(table.text(), draw)
    name = draw.choice(
        (
            "odd.csv",
            "odd.csv",
            "odd.csv",
            "odd.csv.gz",
            "odd.txt",
            "odd",
            "ödd $.csv",
            "odd.mat",
            "odd.parquet",
            "odd.mf4",
        )
    )
    if same and name not in ("odd.csv", "odd.txt", "ödd $.csv"):
        name = "odd.csv"
    Path(name).write_bytes(data)
    words = draw.choice(
        (
            ("simulate", "--inputs", name, *FAST, "-o", "out.csv", "--json", "out.json"),
            ("simulate", "--inputs", name, *FAST, "-o", "out.csv", "--json", "out.json"),
            ("simulate", "--inputs", name, *FAST, "--start-from-recording", "--json", "out.json"),
            ("estimate", name, *FAST, "-o", "out.csv", "--json", "out.json"),
            ("simulate", "--inputs", name, *FAST, "--map", "z1=z4[deg]", "--json", "out.json"),
            ("simulate", "--inputs", name, *FAST, "--map", "pp=p1", "--json", "out.json"),
            ("compare", name, "--json", "out.json"),
            ("diagnose", name, "--json", "out.json"),
            ("improve", name, "-o", "out.toml"),
        )
    )
    return Case(words, name, same and words[0] in ("simulate", "estimate") and "--map" not in words)


# -- crane files -----------------------------------------------------------------------------------------------------

#: values of TOML that no crane has, or that only some have
VALUES = (
    "nan", "inf", "-inf", "0", "-1", "1e308", "-1e308", "1e-308", "1" + 400 * "0", "true", '""', '"abc"', '"25,5 kg"',
    '"1 furlong"', '"100 bar"',
    '"9**9**9 m"', "[]", "[1]", "[1, 2]", "[1, 2, 3]", '["a", "b"]', "{}", "{ a = 1 }", "1979-05-27", '"5 %"',
    '"nan m"', '"inf m"', "1e3", "1e9",
    '"-3 deg"', "{ std = 0 }", "{ lower = 5, upper = 1 }", '"\\u0000"', '"absolute"', '"gauge"', "1e-6", '"1e400 m"',
    "0x10", '"0 m"',
)  # fmt: skip
EFFECTS = (
    'name = "dead_band"', 'name = 5\nplace = "lift"', 'name = "dead_band"\nplace = "tilt"\nparameters = { lower = nan '
                                                      '}', "place = 1",
    'name = "dead_band"\nplace = "boom"', 'name = "pump_droop"\nparameters = { R = 1e300 '
                                          '}', 'name = "seal_friction"\nplace = "lift"\nparameters = 7',
    'name = "internal_leakage"\nplace = "lift"\nparameters = { k = "2,5e-12 m^3/s/Pa" }', 'name = ["dead_band"]',
    'name = "sensor_bias"\nplace = "p4"\nparameters = { bias = "3 bar", bais = 1 '
    '}', 'name = "payload_swing"\nparameters = { length = 1e-9 }',
    'name = "payload_swing"\nparameters = { length = 1.0 }', 'name = "entrained_air"\nparameters = { share = 0.9 '
                                                             '}', 'nam = "dead_band"',
    'name = "structural_compliance"\nplace = "tilt"\nparameters = { c = 1 '
    '}', 'name = "end_stop"\nplace = "lift"', 'name = "x\\ny"',
    'name = "command_delay"\nplace = "lift"\nparameters = { T = 1e9 '
    '}', 'name = "dead_band@lift"', 'name = "base_tilt"\nparameters = { tilt = "90 deg" }',
)  # fmt: skip


def _toml_line(lines: list[str], draw: random.Random) -> None:
    """Change one line with a value: another value, another key, a line twice or gone."""
    places = [i for i, line in enumerate(lines) if "=" in line]
    at = draw.choice(places)
    key, _, value = lines[at].partition("=")
    change = draw.randrange(7)
    if change <= 2:
        lines[at] = f"{key}= {draw.choice(VALUES)}"
    elif change == 3:
        lines[at] = f"{key.strip()}x = {value}"
    elif change == 4:
        del lines[at]
    elif change == 5:
        lines.insert(at, lines[at])
    else:
        lines[at] = re.sub(
            r"-?\d+(\.\d+)?",
            lambda found: f"{float(found.group()) * draw.choice((-1, 0, 1e3, 1e-3, 1e9))!r}",
            lines[at],
            count=1,
        )


def _toml_section(lines: list[str], draw: random.Random) -> None:
    """Take a section away, double it or misname it."""
    heads = [i for i, line in enumerate(lines) if line.startswith("[")]
    if not heads:
        return
    k = draw.randrange(len(heads))
    end = heads[k + 1] if k + 1 < len(heads) else len(lines)
    change = draw.randrange(4)
    if change == 0:
        del lines[heads[k] : end]
    elif change == 1:
        lines += lines[heads[k] : end]
    elif change == 2:
        lines[heads[k]] = lines[heads[k]].replace("[", "[[").replace("]", "]]")
    else:
        lines[heads[k]] = lines[heads[k]].replace("]", "s]")


def crane_case(draw: random.Random) -> Case:
    """Write an odd crane file, and return what is done with it."""
    base = draw.choice(("patu655", "patu655", "patu655-lab"))
    lines = resources.files("crane_exudyn.data").joinpath(f"{base}.toml").read_text(encoding="utf-8").splitlines()
    for _ in range(draw.choice((0, 1, 1, 1, 2))):
        draw.choice((_toml_line, _toml_line, _toml_line, _toml_section))(lines, draw)
    if draw.random() < 0.3:
        lines += ["", "[[effect]]", *draw.choice(EFFECTS).split("\n")]
    text = "\n".join(lines) + "\n"
    data = text.encode()
    if draw.random() < 0.2:
        at = draw.randrange(len(data))
        data = draw.choice(
            (
                data[:at],
                data[:at] + b"\xff\xfe" + data[at:],
                b"\xef\xbb\xbf" + data,
                text.encode("utf-16"),
                b"",
                draw.randbytes(300),
                data.replace(b"\n", b"\r\n"),
                b"[" * 5000,
                data[:at] + b"\x00" + data[at:],
            )
        )
    Path("odd.toml").write_bytes(data)
    words = draw.choice(
        (
            ("simulate", "--inputs", "l.csv", *FAST, "--crane", "odd.toml", "-o", "out.csv", "--json", "out.json"),
            (
                "simulate",
                "--inputs",
                "l.csv",
                *FAST,
                "--start-from-recording",
                "--crane",
                "odd.toml",
                "--json",
                "out.json",
            ),
            ("simulate", "--inputs", "l.csv", "--engine", "exudyn", "--crane", "odd.toml", "--json", "out.json"),
            ("estimate", "l.csv", *FAST, "--crane", "odd.toml", "-o", "out.csv", "--json", "out.json"),
            ("add", "dead_band@tilt", "--crane", "odd.toml", "-o", "out.toml", "--json", "out.json"),
            ("remove", "dead_band@tilt", "--crane", "odd.toml", "-o", "out.toml"),
        )
    )
    return Case(words, "odd.toml")


# -- command lines ---------------------------------------------------------------------------------------------------

WORDS = (
    "", " ", "-", "--", "-o", "l.csv", "./l.csv", "../l.csv", "nowhere.csv", "nodir/x.csv", ".", "/", "/dev/null",
    "/dev/full", "nan", "inf", "-inf", "0",
    "-1", "1e-3", "1e400", "1e-300", "ü", "x" * 300, "a\nb", "a=b", "z1=", "=z1", "z1=z4[deg]", "patu655", "patu66",
    "exudyn", "semi-recursive", "true", "None",
    "out.csv", "out.json", "out.xyz", "out.mat", "out.parquet", "out.csv.gz", "old.json", "payload.mass",
    "dead_band@tilt", "lower=0.1", "lower=1,5", "p1", "ukf",
    "$HOME", "~", "*.csv", "%s", "{}", "\\", "'", '"', "\x00", "\ud800", "1_000", "٣", "--json", "--force", "--help",
    "--no-such", "-j", "-h",
)  # fmt: skip
#: what ends the commands that would work for minutes
STOPPERS = (
    ("--crane", "nowhere"),
    ("--crane", "l.csv"),
    ("--json", "nodir/x.json"),
    ("--json", "."),
    ("--no-such-option",),
    ("--effects", "l.csv"),
)
SLOW = ("--report", "--plot", "--tune", "--fit")
QUICK = ("simulate", "effects", "add", "remove", "estimate")


def _options(name: str) -> list[str]:
    from patu.calls import options_of

    return [option.flag for option in options_of(main.load(name)).values() if option.flag.startswith("-")]


def command_case(draw: random.Random) -> Case:
    """Return an odd command line; those that could work for minutes have a fault in them."""
    name = draw.choice((*QUICK, *QUICK, *QUICK, *main.COMMANDS, "simulte", "", "--version", "-x", "\ud800"))
    start = {
        "simulate": ("--inputs", "l.csv", *FAST),
        "estimate": ("l.csv", *FAST),
        "add": ("dead_band@tilt",),
        "remove": ("dead_band@tilt",),
    }.get(name, ())
    words = [name, *(start if draw.random() < 0.9 else ())]
    flags = _options(name) if name in main.COMMANDS else ["--json"]
    flags = [flag for flag in flags if flag not in SLOW]
    for _ in range(draw.choice((0, 1, 1, 2, 3))):
        flag = draw.choice((*flags, "--force"))
        added = draw.choice(
            (
                [flag, draw.choice(WORDS)],
                [flag, draw.choice(WORDS)],
                [f"{flag}={draw.choice(WORDS)}"],
                [flag],
                [draw.choice(WORDS)],
            )
        )
        words += added
    long = name in main.COMMANDS and name not in QUICK
    if long or (name == "simulate" and "l.csv" not in words):
        for stopper in draw.sample(STOPPERS, 2):  # at the end, where no other option takes its place
            words += stopper
    return Case(tuple(words))


# -- what must hold --------------------------------------------------------------------------------------------------


def _contents(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of every file in a folder."""
    return {
        str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest()
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


def _readable(path: Path) -> bool:
    """Return whether a written file is whole."""
    data = path.read_bytes()
    if data[:1] in (b"{", b"["):
        return bool(json.loads(data))
    if b"\nname =" in b"\n" + data:
        return bool(Crane.load(path).values)
    if path.suffix == ".html":
        return data.rstrip().endswith(b"</html>")
    return Recording.load(path).has("z1")


def problems(case: Case, done: SimpleNamespace, before: dict[str, str], folder: Path, faults: Path) -> Iterator[str]:
    """Yield what must not be."""
    if done.status not in (0, 1, 2):
        yield f"exit status {done.status}"
    if "Traceback" in done.err or "fault of the program" in done.err or list(faults.glob("patu-fault-*")):
        yield "a fault of the program"
    told = [line for line in done.err.splitlines() if not line.startswith("note: ") and ": warning: " not in line]
    if done.status == 2:
        if not told:
            yield "no message"
        if case.odd and not (len(told) == 1 and case.odd in told[0]):
            yield f"not one message that names {case.odd}"
    after = _contents(folder)
    for name, digest in before.items():
        if after.get(name) != digest and not (name == "old.json" and "--force" in case.words):
            yield f"{name} was changed or lost"
    for name in set(after) - set(before):
        if done.status == 2:
            yield f"{name} was written, and the status is 2"
        elif Path(name).name.startswith(".") or not _readable(folder / name):
            yield f"{name} was left half-written"


def _result(folder: Path) -> dict[str, object]:
    """Return the numbers of a run's JSON that are those of the crane, not of the computer."""
    found = json.loads((folder / "out.json").read_text())
    return {k: v for k, v in found.items() if k in ("channels", "duration", "instants", "nis_mean")}


def _differs(one: object, other: object) -> bool:
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() != other.keys() or any(_differs(one[k], other[k]) for k in one)
    if isinstance(one, float) and isinstance(other, float):
        return not np.isclose(one, other, rtol=1e-6, atol=1e-9)  # units are converted once more
    return one != other


KINDS: dict[str, Callable[[dict[str, np.ndarray], random.Random], Case]] = {
    "recording": recording_case,
    "crane": lambda _, draw: crane_case(draw),
    "command": lambda _, draw: command_case(draw),
}


def tried(
    kind: str, number: int, patu: Callable[..., SimpleNamespace], sound: dict[str, np.ndarray], base: Path, clean: Clean
) -> str:
    """Return what is wrong with the answer to one case, as text; "" where nothing is."""
    folder, faults = base / f"{kind}-{number}", Path(tempfile.gettempdir())
    folder.mkdir()
    os.chdir(folder)
    Path("l.csv").write_text(Table(sound).text())
    Path("old.json").write_text("mine\n")
    case = KINDS[kind](sound, random.Random(f"{kind} {number}"))
    before, begin = _contents(folder), time.monotonic()
    done = patu(*case.words)
    said = list(problems(case, done, before, folder, faults))
    if time.monotonic() - begin > LONGEST:  # once more: the first time may compile
        begin = time.monotonic()
        patu(*case.words)
        said += [f"{seconds:.0f} s"] if (seconds := time.monotonic() - begin) > LONGEST else []
    for file in faults.glob("patu-fault-*"):
        said.append(file.read_text())
        file.unlink()
    if case.same and not said:
        said += _changed_result(case, done, patu, folder, clean)
    words = " ".join(map(repr, case.words))
    return f"{kind} {number}: patu {words}: {'; '.join(said)}\n{done.out[-300:]}{done.err}" if said else ""


def _changed_result(
    case: Case, done: SimpleNamespace, patu: Callable[..., SimpleNamespace], folder: Path, clean: Clean
) -> Iterator[str]:
    """Yield what differs from the result of the same recording, written plainly."""
    if done.status == 2:
        yield "refused, though it holds the same"
        return
    result, words = _result(folder), tuple("l.csv" if w == case.odd else w for w in case.words)
    if words not in clean:
        patu(*words, "--force")
        clean[words] = _result(folder)
    if _differs(result, clean[words]):
        yield f"the result is {result}, that of the same recording {clean[words]}"


@pytest.mark.parametrize(("kind", "count"), [("recording", 60), ("crane", 50), ("command", 100)])
def test_an_answer_or_one_message(
    patu: Callable[..., SimpleNamespace],
    sound: dict[str, np.ndarray],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    kind: str,
    count: int,
) -> None:
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    monkeypatch.chdir(tmp_path)
    clean: Clean = {}
    found = [tried(kind, number, patu, sound, tmp_path, clean) for number in range(FIRST, FIRST + (COUNT or count))]
    wrong = list(filter(None, found))
    assert not wrong, f"{len(wrong)} of {len(found)}:\n" + "\n".join(wrong)


# -- live calls ------------------------------------------------------------------------------------------------------

SOUND = {"z1": 0.2, "z4": -0.75, "p1": 48.7e5, "p4": 37.7e5}
SENSORS = {"z1": 1e-3, "z4": 1e-3, "p1": 1e5, "p4": 1e5}
#: what a program may hand over in place of a number, of the commands, of the readings, and seconds by which a clock may
#: leap
ODD_NUMBERS = (
    float("nan"), float("inf"), -float("inf"), 1e308, -1e9, 0.0, None, "0.2", "bar", [1.0], {}, True, 1 + 2j,
    np.float32(0.1),
)  # fmt: skip
ODD_COMMANDS = (
    0.5, [], [0.0], [0.0] * 3, {"u1": 0.0}, {"u9": 1.0, "u1": 0.0}, None, "u1", np.zeros((2, 2)), [[0.0], 0.0],
    [True, 0.0],
)  # fmt: skip
ODD_READINGS = (SOUND | {"z9": 1.0}, {1: 0.2}, [0.2, -0.75], None, "z1")
LEAPS = (-1e9, -1.0, -1e-3, 0.0, 1e-12, 5.0, 600.0, 1e9)


def live_call(draw: random.Random, now: float) -> list[object]:
    """Return commands, readings and a time, one of which may be odd."""
    readings = SOUND | {draw.choice(list(SOUND)): draw.choice(ODD_NUMBERS)}
    some = {n: v for n, v in SOUND.items() if draw.random() < 0.5}
    kinds = (
        {},
        {0: [draw.choice(ODD_NUMBERS), 0.0]},
        {0: draw.choice(ODD_COMMANDS)},
        {1: readings},
        {1: draw.choice(ODD_READINGS)},
        {1: some},
        {2: draw.choice(ODD_NUMBERS)},
        {2: now + draw.choice(LEAPS)},
    )
    odd = draw.choice(kinds)
    return [odd.get(k, sound) for k, sound in enumerate(([0.0, 0.0], SOUND, now))]


def odd_calls(live: Estimator, draw: random.Random) -> float:
    """Make twelve calls of which many are odd; return the time of the last one."""
    now = 0.0
    for _ in range(12):
        now += STEP
        begin = time.process_time()
        try:
            told = live.step(*live_call(draw, now))  # type: ignore[arg-type]
        except CraneError as refusal:
            assert len(str(refusal).splitlines()) == 1
        else:
            assert np.isfinite(told.mean).all() and np.isfinite(told.std).all() and told.mean[4:8].min() >= 0.0
            now = max(now, told.time) if abs(told.time - now) < 1e3 else now
        assert time.process_time() - begin < LONGEST
    return max(now, live.time or 0.0)


@pytest.fixture(scope="module")
def crane() -> Crane:
    """A crane for which everything is compiled that a live call needs."""
    crane = Crane.load("patu655")
    live = Estimator(crane, "semi-recursive", SENSORS, max_step=2.5e-3)
    for k in range(3):
        live.step([0.0, 0.0], SOUND | {"z1": 0.2 + 0.5 * k}, k * STEP)
    return crane


@pytest.mark.parametrize("number", range(FIRST, FIRST + (COUNT or 30)))
def test_after_odd_live_calls_the_sensors_are_followed_again(crane: Crane, number: int) -> None:
    live = Estimator(crane, "semi-recursive", SENSORS, max_step=2.5e-3)
    now = odd_calls(live, random.Random(f"live {number}"))
    for k in range(60):
        told = live.step([0.0, 0.0], SOUND, now + (k + 1) * STEP)
    assert not told.rejected and abs(told["z1"] - 0.2) < 0.005
    assert np.abs([told[n] - SOUND[n] for n in ("p1", "p4")]).max() < 5e5


# -- what it found ---------------------------------------------------------------------------------------------------


@pytest.fixture
def odd(
    patu: Callable[..., SimpleNamespace], sound: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Callable[..., str]:
    """Run a command line on odd.csv, the sound recording with one column changed; return the one message."""
    monkeypatch.chdir(tmp_path)

    def call(*words: str, **changed: float) -> str:
        columns = {n: v * changed.get(n.partition("[")[0], 1.0) for n, v in sound.items()}
        Path("odd.csv").write_text(Table(columns).text())
        done = patu(*words)
        assert done.status == 2 and len(done.err.splitlines()) == 1 and "fault" not in done.err
        return str(done.err)

    return call


def test_a_value_that_overflows_in_si_is_refused(odd: Callable[..., str]) -> None:
    said = odd("simulate", "--inputs", "odd.csv", *FAST, p2=1e305)
    assert "odd.csv, line 2, column p2[bar]" in said and "infinite" in said


def test_the_start_is_taken_from_plausible_sensors_only(odd: Callable[..., str]) -> None:
    assert "p2 " in odd("simulate", "--inputs", "odd.csv", *FAST, "--start-from-recording", p2=1e3)


@pytest.mark.parametrize("word", ["\x00", "a\x00b", "\ud800"])
def test_a_word_that_no_file_can_have_as_its_name_is_bad_input(odd: Callable[..., str], word: str) -> None:
    assert repr(word) in odd("effects", "--json", word)


def test_a_failure_that_knows_the_cranes_name_only_is_told_with_the_files(odd: Callable[..., str]) -> None:
    Crane.load("patu655").with_effect("dead_band@tilt", {"lower": 0.1}).save("own.toml")
    for fitted in ((), ("--fit", "odd.csv")):
        said = odd("add", "dead_band@tilt", "--crane", "own.toml", "-o", "out.toml", *fitted)
        assert "own.toml: patu655 has 'dead_band@tilt' already." in said
    assert "own.toml: patu655 has no effect 'spool_creep@tilt'." in odd(
        "remove", "spool_creep@tilt", "--crane", "own.toml", "-o", "out.toml"
    )
    assert odd("remove", "spool_creep@tilt", "-o", "out.toml").startswith("patu655 has no effect")
    assert "odd.csv" in odd("simulate", "--inputs", "odd.csv", *FAST, time=1e6)
