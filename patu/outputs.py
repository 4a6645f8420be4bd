"""What a command reads and writes: checked in one place before it begins, and nothing that it found out is lost.

The options of a command carry `Reads` or `Writes`. Before the command begins, `plan` refuses an output that is an
input, two outputs that share a file, a place that cannot be written to, and a file that is not the program's own. A
file is the program's own if its content has the SHA-256 of something that a command wrote before: every command adds
what it wrote to the list `written_list()`. So a file that was edited, or that came from elsewhere, is not replaced
without --force.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from crane_exudyn.errors import CraneError
from crane_exudyn.files import check_place, write_text

from .output import STANDARD_OUTPUT, Printer, json_text, write_out


def _itself(text: str) -> str:
    return text


@dataclass(frozen=True)
class Reads:
    """Marks an option that names a file to read; `file` finds its name in what was typed."""

    file: Callable[[str], str] = _itself


@dataclass(frozen=True)
class Writes:
    """Marks an option that names a file to write, or a folder.

    Attributes:
        check: raises CraneError where the ending is none that the command can write.
        files: for a folder: names, or patterns, of the files that may be written into it.
        continues: what stands in the file is gone on with, not replaced.
    """

    check: Callable[[Path], object] = check_place
    files: tuple[str, ...] = ()
    continues: bool = False


@dataclass(frozen=True)
class Target:
    """An output that was asked for: the option's name, the path as typed, where that leads, and how it is written."""

    option: str
    typed: str
    path: Path
    writes: Writes

    def existing(self) -> list[Path]:
        """Return the files that would be replaced."""
        if self.writes.continues:
            return []
        if not self.writes.files:
            return [self.path] if self.path.is_file() else []
        return [found for pattern in self.writes.files for found in sorted(self.path.glob(pattern))]

    def holds(self, path: Path) -> bool:
        """Return whether a file at `path` would be this output, or part of it."""
        if not self.writes.files:
            return path == self.path or _same(path, self.path)
        return path.parent == self.path and any(fnmatchcase(path.name, pattern) for pattern in self.writes.files)

    def meets(self, other: Target) -> bool:
        """Return whether two outputs would write the same file, or a file where the other wants a folder."""
        if not self.writes.files:
            return other.meets(self) if other.writes.files else self.holds(other.path)
        if other.writes.files:
            return self.path == other.path and not set(self.writes.files).isdisjoint(other.writes.files)
        return self.holds(other.path) or other.path in (self.path, *self.path.parents)


def plan(targets: Sequence[Target], inputs: Iterable[str], *, force: bool) -> None:
    """Refuse outputs that could not be written, or that would destroy something; nothing is changed.

    Args:
        targets: all outputs of the command.
        inputs: all files that it reads, as typed.
        force: whether files that are not the program's own may be replaced.

    Raises:
        CraneError: what is wrong with which output, and how to mend it.
    """
    read = [Path(os.path.realpath(name)) for name in inputs if os.path.exists(name)]
    known = _Known()
    for i, target in enumerate(targets):
        _check_writable(target)
        for path in read:
            if target.holds(path):
                raise CraneError(
                    f"{target.option} {target.typed}: {path.name} is also read by this command and would be "
                    "overwritten. Give another name for the result."
                )
        for other in targets[:i]:
            if target.meets(other):
                raise CraneError(
                    f"{other.option} {other.typed} and {target.option} {target.typed}: both would write the same file. "
                    "Give two names."
                )
        for path in [] if force else target.existing():
            if path not in known:
                raise CraneError(
                    f"{path}: this file exists already, and is not as `patu` wrote it. "
                    f"Give {target.option} another name, or replace the file with --force."
                )


def _check_writable(target: Target) -> None:
    """Refuse an ending, a folder or a file that cannot be written."""
    folder = target.path
    if not target.writes.files:
        check_place(target.typed)
        target.writes.check(Path(target.typed))
        folder = target.path.parent
        if target.path.exists() and not os.access(target.path, os.W_OK):
            raise CraneError(f"{target.typed}: this file is write-protected. Give {target.option} another name.")
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
        if not target.writes.files:
            target.path.exists()  # a name that is too long says so
    except OSError as problem:
        raise CraneError(
            f"{target.option} {target.typed}: nothing can be written in {folder}: {problem.strerror}. Give another "
            "place."
        ) from problem


def _same(one: Path, other: Path) -> bool:
    return one.exists() and other.exists() and one.samefile(other)


# -- what the program wrote ------------------------------------------------------------------------------------------


def written_list() -> Path:
    """Return the file that lists the SHA-256 of everything that commands have written, a line each."""
    base = os.environ.get("CRANE_EXUDYN_CACHE") or os.environ.get("XDG_STATE_HOME") or "~/.local/state"
    return Path(os.path.expanduser(base)) / "crane-exudyn" / "written"


def remember(paths: Iterable[Path]) -> None:
    """Add files that were just written to the list; where that is not possible say so, since it matters only later."""
    lines = "".join(f"{_digest(path)}\n" for path in paths if path.is_file())
    if not lines:
        return
    file = written_list()
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("a", encoding="ascii") as stream:
            stream.write(lines)
    except OSError as problem:
        print(
            f"note: {file}: {problem.strerror}; a later run will need --force to replace the files of this run.",
            file=sys.stderr,
        )


class _Known:
    """The files that this program wrote: `path in known`; the list is read when it is first asked."""

    def __init__(self) -> None:
        self._digests: frozenset[str] | None = None

    def __contains__(self, path: Path) -> bool:
        if path.stat().st_size == 0:  # holds nothing that could be lost
            return True
        if self._digests is None:
            try:
                self._digests = frozenset(written_list().read_text(encoding="ascii", errors="replace").split())
            except OSError:
                self._digests = frozenset()
        return bool(self._digests) and _digest(path) in self._digests


def _digest(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


# -- saving ----------------------------------------------------------------------------------------------------------


@dataclass
class Saver:
    """Writes the results of a command one after the other; what one of them suffers does not lose the others."""

    printer: Printer
    failures: list[str] = field(default_factory=list)
    fault: Exception | None = None

    def __call__(self, path: Path | None, write: Callable[[Path], Any], text: str | None = None) -> bool:
        """Return whether a result was written; say where it is.

        Args:
            path: file or folder; None writes nothing.
            write: writes to a path; may return the file or files that it has written there.
            text: the result as text, where it is one; printed if it cannot be written. Other results are then written
                to a new folder among the temporary files.
        """
        if path is None:
            return False
        try:
            written = write(path)
        except (CraneError, OSError) as problem:
            self.failures.append(f"{_why(path, problem)} {self._instead(path, write, text)}".strip())
        except Exception as problem:  # a figure that cannot be drawn, say; told when the other results are safe
            problem.add_note(f"writing {path}")
            self.fault = self.fault or problem
        else:
            for file in written if isinstance(written, list) else [written or path]:
                self.printer.line(f"Written: {file}")
            return True
        return False

    def json(self, destination: str | None, document: Any) -> None:
        """Write the machine-readable result to a file or, for "-", to standard output."""
        text = json_text(document)
        if destination == STANDARD_OUTPUT:
            write_out(text, sys.stdout)
        elif destination is not None:
            self(Path(destination), lambda path: write_text(path, text), text)

    def _instead(self, path: Path, write: Callable[[Path], Any], text: str | None) -> str:
        """Print a text, write anything else to another folder, and return where it is now."""
        if text is not None:
            write_out(text, sys.stderr if self.printer.quiet else sys.stdout)
            return "The result was printed instead."
        try:
            place = Path(tempfile.mkdtemp(prefix="patu-")) / path.name
            write(place)
        except (CraneError, OSError):
            return ""
        return f"The result is in {place} instead."


def _why(path: Path, problem: Exception) -> str:
    return f"{problem.filename or path}: {problem.strerror}." if isinstance(problem, OSError) else str(problem)


@contextmanager
def saving(printer: Printer) -> Iterator[Saver]:
    """Yield what writes the results of a command; at the end complain of all that could not be written, in one message.

    Raises:
        CraneError: a result could not be written. A fault of the program is raised as it is.
    """
    saver = Saver(printer)
    yield saver
    if saver.fault is not None:
        for failure in saver.failures:
            saver.fault.add_note(failure)
        raise saver.fault
    if saver.failures:
        raise CraneError("\n".join(saver.failures))
