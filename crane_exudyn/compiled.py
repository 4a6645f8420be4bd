"""numba's njit, with its cache kept per state of the sources.

numba looks only at the file of the compiled function when it decides whether its cache is still good, not at the files
of the functions called from there. Here every change of any source, and every set of user effects, gets a cache
folder of its own, so that a stale kernel cannot be run.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

from .effects import registry

_PACKAGES = ("crane_exudyn", "ukf", "validation")


def _cache_folder() -> Path:
    root = Path(__file__).resolve().parent.parent
    digest = hashlib.sha256(numba.__version__.encode())
    for package in _PACKAGES:
        for source in sorted((root / package).rglob("*.py")):
            stat = source.stat()
            digest.update(f"{source.relative_to(root)}:{stat.st_size}:{stat.st_mtime_ns}".encode())
    digest.update(registry.fingerprint().encode())
    base = os.environ.get("CRANE_EXUDYN_CACHE") or os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "crane-exudyn" / digest.hexdigest()[:16]


CACHE_FOLDER = _cache_folder()
registry.freeze()
numba.config.CACHE_DIR = str(CACHE_FOLDER)


def njit(*args: Any, **options: Any) -> Callable[..., Any]:
    """numba.njit with a disk cache, numpy's rules for division, and no global lock while it runs."""
    return numba.njit(*args, **{"cache": True, "error_model": "numpy", "nogil": True} | options)
