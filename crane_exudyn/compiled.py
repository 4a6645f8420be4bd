"""numba's njit, with its cache kept per state of the sources.

numba looks only at the file of the compiled function when it decides whether its cache is still good, not at the files
of the functions called from there. Here every change of a source that compiled code may come from, and every set of
user effects, gets a cache folder of its own, so that a stale kernel cannot be run. A change in one package leaves the
cache of the others alone, except that all build on crane_exudyn.

Whoever waits for a compilation is told of it, through the logger of this package.
"""

from __future__ import annotations

import atexit
import functools
import hashlib
import logging
import os
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from llvmlite import ir
from numba.core import codegen, compiler, event, types
from numba.core.registry import CPUDispatcher
from numba.np import arrayobj

from .effects import registry

_ROOT = Path(__file__).resolve().parent.parent
_FOUNDATION = "crane_exudyn"
#: how numba names functions of this project's packages
_OWN = tuple(f"_ZN{len(name)}{name}" for name in (_FOUNDATION, "ukf", "validation"))
#: s of compiling after which it is told
_TOLD_AFTER = 3.0


@functools.cache
def _base() -> Path:
    """Return the folder of all compiled code; one for this run alone where the usual one cannot be written.

    numba would then look for a place of its own beside the sources, where compiled code of other sets of effects
    stands.
    """
    usual = os.environ.get("CRANE_EXUDYN_CACHE") or os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    base = Path(usual) / "crane-exudyn"
    try:
        base.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=base).close()
    except OSError as problem:
        print(
            f"{base}: compiled code cannot be kept there ({problem.strerror}); it is compiled for this run alone. Set "
            "CRANE_EXUDYN_CACHE to "
            "a folder that can be written.",
            file=sys.stderr,
        )
        alone = tempfile.mkdtemp(prefix="crane-exudyn-")
        atexit.register(_remove, alone, os.getpid())
        os.environ["CRANE_EXUDYN_CACHE"] = alone  # for worker processes
        return Path(alone) / "crane-exudyn"
    return base


def _remove(folder: str, owner: int) -> None:
    """Remove a folder, in the process that made it."""
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)


@functools.cache
def cache_folder(package: str = _FOUNDATION) -> Path:
    """Return the folder of compiled code of one top-level package, named after the sources it may come from, and after
    where they are: by that Numba finds it again.
    """
    digest = hashlib.sha256(f"{numba.__version__} {registry.fingerprint()} {_ROOT}".encode())
    for name in sorted({_FOUNDATION, package}):
        for source in sorted((_ROOT / name).rglob("*.py")):
            text = source.read_bytes()
            law = source.parent.name == "effects" and source.stem not in ("registry", "checks", "__init__")
            if b"njit" in text or law or source.name in ("layout.py", "machine.py", "parameters.py", "sensors.py"):
                digest.update(str(source.relative_to(_ROOT)).encode() + b"\0" + text)
    return _base() / digest.hexdigest()[:16]


registry.freeze()


class Announcement(event.Listener):
    """Says once, as a warning of the logger `crane_exudyn`, that functions are being compiled; code from the cache is
    not.
    """

    def __init__(self, after: float = _TOLD_AFTER) -> None:
        self._after = after
        self._depth, self._since, self._spent, self._told = 0, 0.0, 0.0, False

    def on_start(self, event: Any) -> None:
        now = time.monotonic()
        self._since = now if self._depth == 0 else self._since
        self._depth += 1
        if not self._told and self._spent + now - self._since > self._after:
            self._told = True
            logging.getLogger(_FOUNDATION).warning(
                "Compiling the equations, once after an installation or a change: about a minute in all, some more on "
                "a busy machine."
            )

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        self._spent += time.monotonic() - self._since if self._depth == 0 else 0.0


ANNOUNCEMENT = Announcement()
event.register("numba:compile", ANNOUNCEMENT)


def _count_from_the_start() -> None:
    """Have numba take an index that is computed as it is in this project's own compiled code, and only there.

    In Python -1 is the last element, so numba looks at every index whether it is negative, which took a third of the
    time of the equations of motion. None is here: a missing element's -1 is asked for before it is used. numba has no
    option for this; where a release of it has another function, all is as before, and slower.
    """
    usual = getattr(arrayobj, "fix_integer_index", None)
    if usual is None:
        return

    def index(context: Any, builder: Any, kind: Any, value: Any, size: Any) -> Any:
        own = kind.signed and not isinstance(value, ir.Constant) and builder.function.name.startswith(_OWN)
        return context.cast(builder, value, kind, types.intp) if own else usual(context, builder, kind, value, size)

    arrayobj.fix_integer_index = index


_count_from_the_start()

#: how many functions of each name were made by another function
_made: Counter[str] = Counter()


def _named_apart(function: Callable[..., Any]) -> None:
    """Give a function that another function made a name of its own.

    Compiled code refers to a function by its name and a number that counts in one process only. Where code from two
    processes meets, as it does in the cache, two functions of one name would be taken for each other.
    """
    if "<locals>" in function.__qualname__:
        kind = f"{function.__module__}.{function.__qualname__}"
        _made[kind] += 1
        function.__qualname__ += f"_{_made[kind]}"


class _Linked(codegen.CPUCodeLibrary):
    """Code that is only linked into what calls it.

    numba would optimise it and make machine code of it alone as well, and again with everything that calls it, level
    by level: half the time that compiling takes. Here both are done once, where Python calls the whole.
    """

    def _optimize_final_module(self) -> None:
        """Leave it to what this is linked into."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """Return 0: there is no machine code that could be called."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> _Linked:
        """What numba asks to `set_env`."""
        return self

    def set_env(self, name: str, env: Any) -> None:
        """Leave out the objects that a call from Python would need."""


class _Linking(compiler.Compiler):  # type: ignore[misc]
    """Compiles into a `_Linked` library."""

    def compile_extra(self, func: Callable[..., Any]) -> Any:
        self.state.library = _Linked(self.state.targetctx.codegen(), func.__qualname__)
        return super().compile_extra(func)


class _Compiled(CPUDispatcher):
    """A function that Python calls as machine code from the disk cache, and compiled code by linking it in.

    Most functions are called in one of the two ways only, and are compiled for that one.
    """

    @functools.cached_property
    def _inner(self) -> CPUDispatcher:
        """The function as compiled code calls it: without what converts Python's objects, a tenth of the time that
        compiling takes.
        """
        bare = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        return CPUDispatcher(self.py_func, self.locals, {**self.targetoptions, **bare}, _Linking)

    def get_call_template(self, args: Any, kws: Any) -> Any:
        return self._inner.get_call_template(args, kws)

    def get_overload(self, sig: Any) -> Any:
        return self._inner.get_overload(sig)


def njit(function: Callable[..., Any] | None = None, *, cache: bool = True, **options: Any) -> Callable[..., Any]:
    """numba.njit with a disk cache, numpy's rules for division, and no global lock while it runs."""
    if function is None:
        return functools.partial(njit, cache=cache, **options)
    _named_apart(function)
    numba.config.CACHE_DIR = str(cache_folder(function.__module__.partition(".")[0] if cache else _FOUNDATION))
    found = numba.njit(function, **{"cache": cache, "error_model": "numpy", "nogil": True} | options)
    found.__class__ = _Compiled
    return found  # type: ignore[no-any-return]


def lean(function: Callable[..., Any] | None = None, **options: Any) -> Callable[..., Any]:
    """numba.njit for what makes no arrays: it need not count references to those it is given, which would take much of
    its time.
    """
    return njit(function, _nrt=False, **options)
