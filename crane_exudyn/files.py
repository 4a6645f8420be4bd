"""Files are replaced whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

from .errors import CraneError

#: who wants to know which files are finished
_listener: ContextVar[list[Path] | None] = ContextVar("files that were written", default=None)


@contextmanager
def replacing(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path beside `path`; move it over `path` only if the block ends well.

    An interrupted or failing block leaves whatever stood at `path` as it was. A link stays a link: its target is
    replaced.

    Raises:
        CraneError: the file cannot be written, for example for lack of room; the message names it.
    """
    target = check_place(path)
    try:
        temporary = temporary_beside(target)
        try:
            yield temporary
            umask = os.umask(0)
            os.umask(umask)
            temporary.chmod(0o666 & ~umask)
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as problem:  # also of writers that know only the temporary name, or none
        raise CraneError(f"{path}: cannot be written: {problem.strerror or problem}.") from problem
    finished = _listener.get()
    if finished is not None:
        finished.append(target)


def check_place(path: str | Path) -> Path:
    """Return where `path` leads in the end; refuse what no file can be written to.

    Raises:
        CraneError: a folder, a device or a pipe, or a folder above that does not exist.
    """
    target = Path(os.path.realpath(path))
    if not target.parent.is_dir():
        raise CraneError(f"{path}: the folder {target.parent} does not exist. Create it, or give another path.")
    if target.is_dir():
        raise CraneError(f"{path}: this is a folder, expected the name of a file to write. Give one inside it.")
    if target.exists() and not target.is_file():
        raise CraneError(f"{path}: this is a device or a pipe, expected the name of a file to write.")
    return target


@contextmanager
def noting_written() -> Iterator[list[Path]]:
    """Yield a list that grows by every file that is written in the block."""
    written: list[Path] = []
    before = _listener.set(written)
    try:
        yield written
    finally:
        _listener.reset(before)


def write_text(path: str | Path, text: str) -> None:
    """Write `text` to `path` as UTF-8, whole or not at all."""
    with replacing(path) as temporary:
        # a file name that is not Unicode comes with half characters, which UTF-8 does not have
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")


def temporary_beside(target: Path) -> Path:
    """Return a new file in the folder of `target` with its ending, and with a name that is short enough."""
    ending = "".join(target.suffixes[-2:])[-20:]
    handle, name = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name[:20]}-", suffix=ending)
    os.close(handle)
    return Path(name)
