"""One call of a command: its options are checked and its outputs planned before it begins."""

from __future__ import annotations

import inspect
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_type_hints

import typer

from crane_exudyn.errors import CraneError
from crane_exudyn.files import noting_written

from .output import STANDARD_OUTPUT
from .outputs import Reads, Target, Writes, plan, remember

ForceOption = Annotated[
    bool, typer.Option("--force", help="Replace existing files, even those that patu did not write.")
]


#: what is given to options in every call
_NUMBER_OR_CHOICE = re.compile(r"-?[\d.e-]*|True|False|auto|exudyn|semi-recursive")
#: what the source of a value that stood on the command line is called
_TYPED = "COMMANDLINE"


class Option(NamedTuple):
    """An option or argument of a command: how it is typed, and what its file is for."""

    flag: str
    role: Reads | Writes | None


def checked(command: Callable[..., None]) -> Callable[..., None]:
    """Return the command for typer, with the option --force, and with everything checked before it is called."""
    known = options_of(command)

    def call(*, force: bool, **values: Any) -> None:
        for name, value in values.items():
            _check_finite(known[name].flag, value)
        read = _inputs(known, values)
        plan(_targets(known, values), read, force=force)
        with noting_written() as written:
            try:
                command(**values)
            except CraneError as problem:
                raise _naming(problem, read, _others_typed(known, values)) from problem
            finally:
                remember(written)

    hints = get_type_hints(command, include_extras=True) | {"force": ForceOption}
    parameters = [p.replace(annotation=hints[p.name]) for p in inspect.signature(command).parameters.values()]
    force = inspect.Parameter("force", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=ForceOption)
    call.__signature__ = inspect.Signature([*parameters, force])  # type: ignore[attr-defined]
    call.__annotations__ = hints
    return call


def refuse_idle(context: typer.Context, *rules: tuple[bool, Sequence[str], str]) -> None:
    """Refuse options that were typed and would change nothing.

    Args:
        context: of the call; typer gives it to a command with a parameter of this type.
        rules: whether one holds, the flags that are then idle (or the metavar of an argument), and why.

    Raises:
        CraneError: which options, and why.
    """
    typed = [p for p in context.command.params if getattr(context.get_parameter_source(p.name), "name", "") == _TYPED]
    flags = {flag for p in typed for flag in ([p.metavar] if p.param_type_name == "argument" else p.opts)}
    for holds, options, why in rules:
        idle = [option for option in options if option in flags]
        if holds and idle:
            raise CraneError(f"{', '.join(idle)} would change nothing: {why}. Leave it out, or add what it needs.")


def options_of(command: Callable[..., None]) -> dict[str, Option]:
    """Return the options of a command by the name of their parameter."""
    found = {}
    for name, hint in get_type_hints(command, include_extras=True).items():
        marks = getattr(hint, "__metadata__", ())
        role = next((m for m in marks if isinstance(m, Reads | Writes)), None)
        found[name] = Option(next((_flag(name, m) for m in marks if not isinstance(m, Reads | Writes)), name), role)
    return found


def _flag(name: str, information: Any) -> str:
    """Return how an option is typed, in its short form where it has one, or the name of an argument."""
    declared = [d for d in (information.default, *(information.param_decls or ())) if isinstance(d, str)]
    usual = f"--{name.replace('_', '-')}"
    return str(information.metavar or name) if _is_argument(information) else min(declared, key=len, default=usual)


def _is_argument(information: Any) -> bool:
    return isinstance(information, type(typer.Argument()))


def _check_finite(flag: str, value: Any) -> None:
    for number in value if isinstance(value, list | tuple) else [value]:
        if isinstance(number, float) and not math.isfinite(number):
            raise CraneError(f"{flag} {number}: expected a finite number.")


def _naming(problem: CraneError, read: list[str], others: list[str]) -> CraneError:
    """Return the error with the files that were read, where its message is about what they hold and names none of them:
    engines know a crane's name only. It is not where it names an option, or one of the `others` that were typed.
    """
    files, message = [name for name in read if os.path.isfile(name)], str(problem)
    about_contents = "--" not in message and not any(_names(message, word) for word in others)
    named = any(name in message for name in read if os.path.splitext(name)[1])  # but for a built-in crane's name
    if not files or not about_contents or named:
        return problem
    return CraneError(f"{message} Files read: {', '.join(files)}.")


def _names(message: str, word: str) -> bool:
    """Whether a message holds a word as a whole."""
    return re.search(rf"(?<!\w){re.escape(word)}(?!\w)", message) is not None


def _others_typed(known: Mapping[str, Option], values: Mapping[str, Any]) -> list[str]:
    """Return the words that were given to a call for anything but the files that it reads."""
    others = [v for n, v in values.items() if not isinstance(known[n].role, Reads) and v is not None]
    words = [str(word) for v in others for word in (v if isinstance(v, list | tuple) else [v])]
    return [word for word in words if not _NUMBER_OR_CHOICE.fullmatch(word)]


def _targets(known: Mapping[str, Option], values: Mapping[str, Any]) -> list[Target]:
    """Return the outputs that one call asks for."""
    return [
        Target(known[name].flag, str(value), Path(os.path.realpath(value)), role)
        for name, value in values.items()
        if isinstance(role := known[name].role, Writes) and value is not None and str(value) != STANDARD_OUTPUT
    ]


def _inputs(known: Mapping[str, Option], values: Mapping[str, Any]) -> list[str]:
    """Return the files that one call names for reading."""
    found: list[str] = []
    for name, value in values.items():
        role = known[name].role
        if isinstance(role, Reads) and value is not None:
            found += [role.file(str(v)) for v in (value if isinstance(value, list | tuple) else [value])]
    return found
