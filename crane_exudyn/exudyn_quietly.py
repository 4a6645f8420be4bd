"""Exudyn as every file here imports it: without a word on standard output, and always the same build of it."""

from __future__ import annotations

import contextlib
import io
import sys

if "exudyn" not in sys.modules and not hasattr(sys, "exudynFast"):
    sys.exudynFast = True  # type: ignore[attr-defined]  # the build without range checks; read when exudyn is imported
with contextlib.redirect_stdout(io.StringIO()):  # it announces itself, which would spoil a JSON on standard output
    import exudyn as exu
    import exudyn.graphics as draw
    import exudyn.itemInterface as items

__all__ = ["draw", "exu", "items"]
