"""The one exception class for input that a user can mend, and what failures are told with."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from numbers import Integral
from os import PathLike
from pathlib import Path
from textwrap import shorten
from typing import Any


class CraneError(ValueError):
    """Bad input, told in one message: what was found, where, what was expected and how to mend it.

    The command line prints the message without a traceback and exits with status 2.
    """


@contextmanager
def doing(what: str) -> Iterator[None]:
    """Let a failure of the block carry along what was being done, such as "reading lift.csv", for whoever tells it."""
    try:
        yield
    except Exception as problem:
        problem.add_note(what)
        raise


def shortened(value: object, most: int = 60) -> str:
    """Return what was given, as Python writes it, in one line of at most so many characters."""
    return shorten(repr(value), most)


def listed(names: Iterable[str], values: Iterable[float], form: str) -> str:
    """Return names with their values, such as "z1 = 10.00 deg, z4 = -40.00 deg" for the form "{:.2f} deg"."""
    return ", ".join(f"{name} = {form.format(value)}" for name, value in zip(names, values, strict=True))


def refuse_unknown(where: str, keys: Iterable[str], known: Collection[str], what: str = "key") -> None:
    """Raise CraneError for the first of some keys that is not known; `where` begins the message."""
    for key in keys:
        if key not in known:
            raise CraneError(f"{where}: unknown {what} {key!r}.{nearest(str(key), list(known))}")


def counted(value: Any, what: str) -> int:
    """Return a whole number of at least 1. Raises CraneError for anything else; `what` names it."""
    if isinstance(value, Integral) and not isinstance(value, bool) and int(value) >= 1:
        return int(value)
    raise CraneError(f"{what} is {shortened(value)}. Give a whole number of at least 1.")


def names_of(given: Any, what: str) -> tuple[str, ...]:
    """Return names that were given as a list or the like; a lone text is one. Raises CraneError for anything else;
    `what` tells what they are of.
    """
    if isinstance(given, str):
        return (given,)
    if isinstance(given, Iterable):
        return tuple(given)
    raise CraneError(f"{what}: found {shortened(given)}, expected names. Give a list of them.")


def by_name(given: Any, what: str, example: str) -> dict[str, Any]:
    """Return what was given by name as `what`, in a dict or the like, also a pandas DataFrame. Raises CraneError, which
    shows an example, for anything else.
    """
    if hasattr(given, "keys"):
        return dict(given)
    raise CraneError(f"{what}: found {shortened(given)}, expected values by name. Give a dict such as {example}.")


def named_file(given: Any, whom: str) -> Path:
    """Return the path that was given to `whom`. Raises CraneError for anything that is none."""
    if isinstance(given, str | PathLike):
        return Path(given)
    raise CraneError(f"{whom}: found {shortened(given)}, expected the name of a file. Give it as text, or as a Path.")


def nearest(word: object, known: list[str]) -> str:
    """Return ' Did you mean "…"?' for the known word most like `word`, or a list of what is known."""
    import difflib

    if not known:
        return " There are none."
    close = difflib.get_close_matches(str(word), known, n=3, cutoff=0.5)
    if close:
        return " Did you mean " + " or ".join(f'"{c}"' for c in close) + "?"
    shown = ", ".join(known[:12]) + (", …" if len(known) > 12 else "")
    return f" Known: {shown}."
