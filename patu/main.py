"""The command `patu`: finds the command asked for, imports only that one, and turns whatever fails into one message."""

from __future__ import annotations

import errno
import functools
import importlib
import os
import signal
import sys
import threading
import time
import weakref
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple

#: options that take all words up to the next option
SEVERAL = ("--models", "--sensors", "--sensor-noise")
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
    "demo": Command(
        "run the main steps on the recordings in the package; writes a report and pictures",
        "patu demo -o out/demo",
    ),
    "sample": Command("write example recordings to try the commands on", "patu sample out/sample"),
    "check": Command("check a recording: signs, units, exchanged channels, clocks", "patu check lift.csv"),
    "simulate": Command("run the crane open loop", "patu simulate --inputs lift.csv -o run.csv"),
    "estimate": Command(
        "estimate the states with a UKF: intervals, consistency", "patu estimate lift.csv -o states.csv"
    ),
    "crosscheck": Command("compare the two engines, quantity by quantity", "patu crosscheck"),
    "compare": Command("compare the model with a measurement: errors, and where it fails", "patu compare lift.csv"),
    "diagnose": Command("find which physical effect the model lacks", "patu diagnose lift.csv --check lower.csv"),
    "learn": Command("learn a law that the library does not have, as a curve", "patu learn lift.csv -o new.toml"),
    "add": Command(
        "add an effect, fitted, to a crane file",
        "patu add internal_leakage@lift --fit lift.csv -o new.toml",
    ),
    "remove": Command("undo `add`", "patu remove internal_leakage@lift --crane new.toml", "add", "remove"),
    "improve": Command(
        "compare, diagnose, add, until nothing more is justified", "patu improve lift.csv --check lower.csv -o new.toml"
    ),
    "effects": Command("list the effects, their laws and parameters", "patu effects dead_band"),
    "paper": Command("reproduce the paper's tables and figures", "patu paper"),
    "render": Command("draw pictures and films with the Exudyn renderer", "patu render run.csv -o run.png"),
    "benchmark": Command("measure speed and memory, as ratios within one run", "patu benchmark --json -"),
    "montecarlo": Command("test the filter over many random runs", "patu montecarlo -n 20"),
}


def help_text() -> str:
    """Return what `patu --help` prints."""
    width = max(map(len, COMMANDS))
    lines = [f"  {name:<{width}}  {command.text}" for name, command in COMMANDS.items()]
    return "\n".join(
        [
            "Usage: patu COMMAND [OPTIONS] …",
            "",
            "Planar hydraulic machines on Exudyn: simulate, estimate, find what the model lacks.",
            "",
            "Commands:",
            *lines,
            "",
            "`patu COMMAND --help` shows its options. Example: patu demo -o out/demo",
            "Exit status: 0 success, 1 the answer is no, 2 bad input.",
        ]
    )


class Leave(BaseException):
    """Ends a command with a status and a message, past everything that catches exceptions."""

    def __init__(self, status: int, message: str = "") -> None:
        super().__init__(message)
        self.status = status
        self.message = message


def run(arguments: Sequence[str] | None = None) -> None:
    """Run one command line and leave with its exit status; whatever fails gives one message and no traceback."""
    from .output import show_any_sign

    words = list(sys.argv[1:] if arguments is None else arguments)
    show_any_sign()
    with _Endings() as endings:
        try:
            status = _dispatch(words)
            sys.stdout.flush()
        except BaseException as problem:
            status = _failed(endings.cause_of(problem), words)
    if endings.came and any(not t.daemon for t in threading.enumerate() if t is not threading.main_thread()):
        os._exit(status)  # a thread is in compiled code, or compiling; Python would wait for it
    sys.exit(status)


class _Endings:
    """Turns the signals that end a program into `Leave`, so that temporary files go and half-written ones never were.

    An exception that a signal's handler raises inside a callback from compiled code comes out as another one, or not at
    all. So the signal is kept, and `Leave` is raised again if the last one has vanished without ending the program, or
    has been stuck for long where something is waited for.
    """

    _SAID: ClassVar = {signal.SIGINT: "Interrupted", signal.SIGTERM: "Terminated", signal.SIGHUP: "Hung up"}
    _LOOK, _PATIENCE = 0.5, 2.0  # s

    def __init__(self) -> None:
        self._number = 0
        self._raised: Callable[[], Leave | None] = lambda: None
        self._when = 0.0
        self._usual: dict[int, Any] = {}
        self._complain = sys.unraisablehook

    def __enter__(self) -> _Endings:
        sys.unraisablehook = self._unraisable
        if threading.current_thread() is threading.main_thread():  # only there signals can be set
            heard = [n for n in self._SAID if signal.getsignal(n) not in (signal.SIG_IGN, None)]
            self._usual = {n: signal.signal(n, self._arrived) for n in heard}
            self._usual[signal.SIGALRM] = signal.signal(signal.SIGALRM, self._again)
        return self

    def __exit__(self, *_: object) -> None:
        if self._usual:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, usual in self._usual.items():
            signal.signal(number, usual)
        sys.unraisablehook = self._complain

    @property
    def came(self) -> bool:
        """Whether a signal came."""
        return self._number != 0

    def cause_of(self, problem: BaseException) -> BaseException:
        """Return what really ended the program: the signal, if one came, else the exception."""
        return self._leave() if self.came else problem

    def _leave(self) -> Leave:
        return Leave(128 + self._number, f"{self._SAID[signal.Signals(self._number)]}; no file was left half-written.")

    def _arrived(self, number: int, _: object) -> None:
        self._number = number
        signal.setitimer(signal.ITIMER_REAL, self._LOOK, self._LOOK)
        raise self._watched()

    def _again(self, *_: object) -> None:
        if self._raised() is None or time.monotonic() > self._when + self._PATIENCE:
            raise self._watched()

    def _watched(self) -> Leave:
        """Return an exception of which is known when it has vanished; no frame of its traceback may hold it."""
        leaving = self._leave()
        self._raised, self._when = weakref.ref(leaving), time.monotonic()
        return leaving

    def _unraisable(self, what: Any) -> None:
        if not isinstance(what.exc_value, Leave):  # that one comes again
            self._complain(what)


def _failed(problem: BaseException, words: Sequence[str]) -> int:
    """Say in one message why a command ended, and return its exit status."""
    from crane_exudyn.errors import CraneError

    from .output import stop_writing

    if isinstance(problem, BrokenPipeError | Leave) and not getattr(problem, "status", 0):
        stop_writing()  # `patu effects | head`: the reader has seen enough
        return 0
    if isinstance(problem, Leave):
        return _complain(problem.message, problem.status)
    if isinstance(problem, KeyboardInterrupt):  # where no signals could be set
        return _complain("Interrupted; no file was left half-written.", INTERRUPTED)
    if isinstance(problem, CraneError):
        return _complain(str(problem), BAD_INPUT)
    if isinstance(problem, OSError):
        return _complain(f"{_place(problem, words)}: {problem.strerror or problem}.", BAD_INPUT)
    if isinstance(problem, MemoryError):
        return _complain(
            f"{_command(words)}: there is not enough memory{_while(problem)}. {problem}".strip(), BAD_INPUT
        )
    return _complain(_fault(problem, words), BAD_INPUT)


def _place(problem: OSError, words: Sequence[str]) -> str:
    """Return where a failure happened: a file, or standard output, since writing to anything else names its file."""
    if problem.filename is None and problem.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EBADF):
        from .output import stop_writing

        stop_writing()
        return "standard output"
    return str(problem.filename or _command(words))


def _fault(problem: BaseException, words: Sequence[str]) -> str:
    """Return what to say of a fault of the program; its traceback goes to a file."""
    import tempfile
    import traceback

    from crane_exudyn import __version__

    whole = "".join(traceback.format_exception(problem))
    text = f"crane-exudyn {__version__}, Python {sys.version}\npatu {' '.join(words)}\n\n{whole}"
    named = (
        f"{_command(words)} failed{_while(problem)}: {type(problem).__name__}: {str(problem).partition(chr(10))[0]}."
    )
    try:
        handle, name = tempfile.mkstemp(prefix="patu-fault-", suffix=".txt")
        with open(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write(text)
    except OSError:
        return f"{named} This is a fault of the program. Please report it.\n{whole}"
    return f"{named} This is a fault of the program, not of your input. Please report it and attach {name}."


def _while(problem: BaseException) -> str:
    """Return what was being done when it happened, from the innermost to the outermost."""
    notes = getattr(problem, "__notes__", [])
    return f" ({', '.join(notes)})" if notes else ""


def _command(words: Sequence[str]) -> str:
    return " ".join(["patu", *words[:1]])


def _complain(message: str, status: int) -> int:
    print(message, file=sys.stderr)
    return status


def _check_signs(words: Sequence[str]) -> None:
    """Refuse what no shell can type, but another program may give: no file can have such a name, nothing can write
    it.
    """
    from crane_exudyn.errors import CraneError

    for word in words:
        try:
            typed = b"\0" not in os.fsencode(word)
        except UnicodeEncodeError:
            typed = False
        if not typed:
            raise CraneError(f"{word!r}: contains a character that no name or value can have. Remove it.")


def _dispatch(words: list[str]) -> int:
    _check_signs(words)
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

    from .calls import checked

    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
    app.command(
        help=_help(name),
        epilog=f"Example: {COMMANDS[name].example}",
        context_settings={"help_option_names": ["--help", "-h"]},
    )(_past_typer(checked(load(name))))
    words = one_each(words)
    try:
        app(words, prog_name=f"patu {name}")
    except SystemExit as leaving:  # typer ends every run, good or bad, this way
        _tell_taken(words, leaving.__context__)
        return leaving.code if isinstance(leaving.code, int) else int(leaving.code is not None)
    return 0


def _tell_taken(words: Sequence[str], problem: BaseException | None) -> None:
    """Where an argument is missing, say which word went to an option of several values instead."""
    taken = [(option, word) for option, word in pairwise(words) if option in SEVERAL]
    missing: Any = getattr(problem, "param", None)
    if taken and type(problem).__name__ == "MissingParameter" and getattr(missing, "param_type_name", "") == "argument":
        option, word = taken[-1]
        print(f"{word} was read as a value of {option}; put {missing.metavar} first.", file=sys.stderr)


def one_each(words: Sequence[str]) -> list[str]:
    """Return the words with `--models A B` as `--models A --models B`: options of typer take one value each."""
    out: list[str] = []
    taking = ""
    for word in words:
        if word.startswith("-"):
            taking = word if word in SEVERAL else ""
        elif taking and out[-1] != taking:
            out.append(taking)
        out.append(word)
    return out


def _past_typer(command: Callable[..., None]) -> Callable[..., None]:
    """Return the command with a closed pipe turned into `Leave`, since typer would answer it itself."""

    @functools.wraps(command)
    def guarded(**options: Any) -> None:
        try:
            command(**options)
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
