"""Screens for Exudyn's windows: the one there is, or Xvfb, which makes one in memory."""

from __future__ import annotations

import contextlib
import os
import select
import shutil
import subprocess
from collections.abc import Iterator
from typing import Any

from .errors import CraneError

_SECONDS_TO_START = 20.0
_MISSING = (
    "There is no screen (DISPLAY is not set), and the program Xvfb, which makes one in memory, was not found. "
    "Install the Debian package xvfb, or leave --renderer opengl out: the ray tracer needs no screen."
)


def has_screen() -> bool:
    """Return whether a window could be opened."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY") or os.name == "nt")


def need_screen(what: str) -> None:
    """Raise CraneError if there is no screen for an interactive window."""
    if not has_screen():
        raise CraneError(f"{what} needs a screen, and DISPLAY is not set. Write a picture instead: -o FILE.png.")


@contextlib.contextmanager
def screen(size: tuple[int, int]) -> Iterator[None]:
    """Make sure that a window can be opened: uses the screen there is, or starts Xvfb and ends it again."""
    if has_screen():
        yield
        return
    process, display = _start_xvfb(size)
    os.environ["DISPLAY"] = display
    try:
        yield
    finally:
        os.environ.pop("DISPLAY", None)
        process.terminate()
        process.wait()


def _start_xvfb(size: tuple[int, int]) -> tuple[subprocess.Popen[bytes], str]:
    """Start Xvfb on a free display number, which it chooses and tells through a pipe."""
    program = shutil.which("Xvfb")
    if program is None:
        raise CraneError(_MISSING)
    reading, writing = os.pipe()
    command = [program, "-displayfd", str(writing), "-screen", "0", f"{size[0]}x{size[1]}x24", "-nolisten", "tcp"]
    process = subprocess.Popen(command, pass_fds=[writing], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    os.close(writing)
    with open(reading, encoding="ascii") as pipe:
        number = _first_line(pipe)
    if not number:
        process.kill()
        process.wait()
        raise CraneError(f"{program} did not start. See what `{program} :99` says, or leave --renderer opengl out.")
    return process, f":{number}"


def _first_line(pipe: Any) -> str:
    ready, _, _ = select.select([pipe], [], [], _SECONDS_TO_START)
    return pipe.readline().strip() if ready else ""
