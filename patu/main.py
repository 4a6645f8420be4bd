"""The command `patu`: finds the command asked for, imports only that one, and turns bad input into one message."""

from __future__ import annotations

import functools
import importlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

BAD_INPUT = 2
INTERRUPTED = 130


class Command(NamedTuple):
    """One line of the table of commands: what it does, an example, and where its function stands."""

    text: str
    example: str
    module: str = ""
    function: str = "command"


#: all commands, in the order of the help; nothing of them is imported before it is asked for
COMMANDS: dict[str, Command] = {
    "demo": Command("the paper's experiment on the Exudyn engine: table, plots, report", "patu demo -o out/demo"),
    "simulate": Command("open-loop run of the crane", "patu simulate --inputs lift.csv -o run.csv"),
    "estimate": Command("UKF over a recording: states, intervals, consistency", "patu estimate lift.csv -o states.csv"),
    "crosscheck": Command("both engines against each other, quantity by quantity", "patu crosscheck"),
    "compare": Command("model against measurement: how good, and where it fails", "patu compare lift.csv"),
    "diagnose": Command("which physical effect is missing", "patu diagnose lift.csv --check lower.csv"),
    "add": Command(
        "add an effect, fitted, to a crane file",
        "patu add internal_leakage@lift --fit lift.csv -o new.toml",
    ),
    "remove": Command("undo `add`", "patu remove internal_leakage@lift --crane new.toml", "add", "remove"),
    "improve": Command(
        "compare, diagnose, add, until nothing more is justified", "patu improve lift.csv --check lower.csv -o new.toml"
    ),
    "effects": Command("what effects there are, their laws and parameters", "patu effects dead_band"),
    "paper": Command("reproduce the paper's tables and figures", "patu paper"),
    "render": Command("pictures and films through the Exudyn renderer", "patu render run.csv -o run.png"),
    "benchmark": Command("speed and memory, as ratios measured in one run", "patu benchmark --json -"),
    "montecarlo": Command("the estimate over many random errors and seeds", "patu montecarlo -n 20"),
}


def help_text() -> str:
    """Return what `patu --help` prints."""
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {command.text}" for name, command in COMMANDS.items()]
    return "\n".join(
        [
            "Usage: patu COMMAND [OPTIONS] …",
            "",
            "A hydraulic log crane on Exudyn: simulate, estimate, find what the model lacks.",
            "",
            "Commands:",
            *lines,
            "",
            "`patu COMMAND --help` tells its options. Example: patu demo -o out/demo",
            "Exit status: 0 success, 1 the answer is no, 2 bad input.",
        ]
    )


class Leave(BaseException):
    """Ends a command with a status, past typer, which would answer an interrupt with a status of its own."""

    def __init__(self, status: int, message: str = "") -> None:
        super().__init__(message)
        self.status = status
        self.message = message


def run(arguments: Sequence[str] | None = None) -> None:
    """Run one command line and leave with its exit status; bad input gives one message and no traceback."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        with _terminations_clean_up():
            status = _guarded(words)
            sys.stdout.flush()
    except (Leave, BrokenPipeError) as leaving:
        status = _leave(leaving)
    sys.exit(status)


@contextmanager
def _terminations_clean_up() -> Iterator[None]:
    """Let a termination end the block as an interrupt does, so that temporary files go and half-written ones never were."""
    if threading.current_thread() is not threading.main_thread():  # only there signals can be set
        yield
        return
    usual = signal.signal(signal.SIGTERM, _terminated)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, usual)


def _terminated(number: int, _: object) -> None:
    raise Leave(128 + number, "Terminated; no file was left half-written.")


def _leave(leaving: BaseException) -> int:
    if isinstance(leaving, Leave) and leaving.status:
        return _complain(leaving.message, leaving.status)
    # `patu effects | head`: the reader has seen enough, and Python must not complain when it flushes at its end
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 0


def _guarded(words: list[str]) -> int:
    from crane_exudyn.errors import CraneError

    try:
        return _dispatch(words)
    except CraneError as problem:
        return _complain(str(problem), BAD_INPUT)
    except KeyboardInterrupt:
        raise Leave(INTERRUPTED, "Interrupted; no file was left half-written.") from None
    except BrokenPipeError:
        raise
    except OSError as problem:
        if problem.filename is None:
            raise
        return _complain(f"{problem.filename}: {problem.strerror}.", BAD_INPUT)


def _complain(message: str, status: int) -> int:
    print(message, file=sys.stderr)
    return status


def _dispatch(words: list[str]) -> int:
    if not words or words[0] in ("--help", "-h", "help"):
        print(help_text())
        return 0 if words else BAD_INPUT
    if words[0] in ("--version", "-V"):
        from crane_exudyn import __version__

        print(f"patu {__version__}")
        return 0
    if words[0] not in COMMANDS:
        from crane_exudyn.errors import CraneError, nearest

        raise CraneError(f"There is no command {words[0]!r}.{nearest(words[0], list(COMMANDS))}")
    return _invoke(words[0], words[1:])


def _invoke(name: str, words: list[str]) -> int:
    import typer

    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
    app.command(
        help=_help(name),
        epilog=f"Example: {COMMANDS[name].example}",
        context_settings={"help_option_names": ["--help", "-h"]},
    )(_past_typer(load(name)))
    try:
        app(words, prog_name=f"patu {name}")
    except SystemExit as leaving:  # typer ends every run, good or bad, this way
        return leaving.code if isinstance(leaving.code, int) else int(leaving.code is not None)
    return 0


def _past_typer(command: Callable[..., None]) -> Callable[..., None]:
    """Return the command with those exceptions turned into `Leave` that typer would answer itself."""

    @functools.wraps(command)
    def guarded(*args: Any, **options: Any) -> None:
        try:
            command(*args, **options)
        except KeyboardInterrupt:
            raise Leave(INTERRUPTED, "Interrupted; no file was left half-written.") from None
        except BrokenPipeError:
            raise Leave(0) from None

    return guarded


def load(name: str) -> Callable[..., None]:
    """Return the function behind a command; this is what imports its module."""
    command = COMMANDS[name]
    module = importlib.import_module(f"patu.{command.module or name}")
    function: Callable[..., None] = getattr(module, command.function)
    return function


def _help(name: str) -> str:
    """Return the docstring's first paragraphs, up to the part that is for programmers."""
    return (load(name).__doc__ or COMMANDS[name].text).split("\n    Args:")[0]


if __name__ == "__main__":
    run()
