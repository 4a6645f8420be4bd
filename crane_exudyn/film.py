"""Frames into files: pictures, GIF and MP4 films."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Literal

import numpy as np

from .errors import CraneError

Kind = Literal["picture", "gif", "mp4"]
_KINDS: dict[str, Kind] = {".png": "picture", ".jpg": "picture", ".jpeg": "picture", ".gif": "gif", ".mp4": "mp4"}


def kind_of(path: str | Path) -> Kind:
    """Return what a file is to become, by its ending.

    Raises:
        CraneError: an ending that is not known; for MP4, if the package that writes it is not installed.
    """
    ending = Path(path).suffix.lower()
    if ending not in _KINDS:
        raise CraneError(f"{path}: found the ending {ending!r}, expected {', '.join(_KINDS)}. Choose one of them.")
    if ending == ".mp4":
        _need_ffmpeg(path)
    return _KINDS[ending]


def _need_ffmpeg(path: str | Path) -> None:
    from importlib.util import find_spec

    if find_spec("imageio_ffmpeg") is None:
        raise CraneError(
            f"{path}: writing MP4 needs the package imageio-ffmpeg. Install it with "
            "pip install imageio-ffmpeg, or write a GIF."
        )


def times(start: float, end: float, fps: float, speed: float) -> np.ndarray:
    """Return the times of a film's frames in s of the run: `fps` a second of film, each second showing `speed` s.

    Raises:
        CraneError: a rate or a speed that is not positive, or an end before the start.
    """
    for name, value in (("--fps", fps), ("--speed", speed)):
        if not value > 0.0:
            raise CraneError(f"{name} {value:g} is not positive. Give a number above zero.")
    if not end > start:
        raise CraneError(f"The film would end at {end:g} s, not after its start at {start:g} s. Give a later end.")
    return np.arange(start, end + 1e-9, speed / fps)


def write(
    path: Path,
    kind: Kind,
    frames: Iterator[np.ndarray],
    count: int,
    fps: float,
    progress: Callable[[float], None] | None = None,
) -> None:
    """Write frames (height, width, 3) uint8 as a picture or film of the given kind."""
    counted = _counted(frames, count, progress)
    if kind == "picture":
        _image(next(iter(counted))).save(path)
    elif kind == "gif":
        _write_gif(path, counted, count, fps)
    else:
        _write_mp4(path, counted, fps)


def _counted(
    frames: Iterable[np.ndarray], count: int, progress: Callable[[float], None] | None
) -> Iterator[np.ndarray]:
    for i, frame in enumerate(frames, start=1):
        yield frame
        if progress is not None:
            progress(i / count)


def _image(frame: np.ndarray):  # type: ignore[no-untyped-def]
    from PIL import Image

    return Image.fromarray(frame)


def _write_gif(path: Path, frames: Iterator[np.ndarray], count: int, fps: float) -> None:
    """Write a GIF that repeats for ever; one palette for all frames, so that colours do not flicker."""
    first = _image(next(frames)).quantize(256, dither=0)
    rest = (_image(frame).quantize(palette=first, dither=0) for frame in frames)
    ends = np.round(np.arange(count + 1) * 100.0 / fps)  # GIF counts in hundredths of a second
    durations = (10.0 * np.diff(ends)).astype(int).tolist()
    first.save(path, format="GIF", save_all=True, append_images=rest, duration=durations, loop=0)


def _write_mp4(path: Path, frames: Iterator[np.ndarray], fps: float) -> None:
    """Write H.264 that every browser plays; sizes are even, as the format asks."""
    from imageio_ffmpeg import write_frames

    first = next(frames)
    height, width = (n - n % 2 for n in first.shape[:2])
    writer = write_frames(str(path), (width, height), fps=fps, codec="libx264", quality=8, macro_block_size=2)
    writer.send(None)
    try:
        writer.send(np.ascontiguousarray(first[:height, :width]))
        for frame in frames:
            writer.send(np.ascontiguousarray(frame[:height, :width]))
    finally:
        writer.close()
