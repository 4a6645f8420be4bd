"""Which effects there are, in which order, and where their parameters stand in the flat vector E."""

from __future__ import annotations

import difflib
import hashlib
import importlib
import importlib.util
import inspect
import sys
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np

from ..errors import CraneError, named_file, nearest
from ..layout import MOST, Layout
from .base import Effect
from .checks import checked

#: modules of the built-in effects; the order is that of the vector E
BUILT_IN = (
    "internal_leakage", "external_leakage", "dead_band", "meter_out_restriction", "pressure_compensation",
    "command_delay", "spool_hysteresis", "counterbalance_valve", "entrained_air", "pump_droop", "return_back_pressure",
    "seal_friction", "pressure_dependent_friction", "joint_coulomb_friction", "joint_viscous_friction",
    "structural_compliance", "payload_change", "payload_swing", "tip_contact_force", "base_tilt", "end_stop",
    "sensor_bias", "sensor_scale", "sensor_lag", "released_air", "stuck_seal", "spool_creep",
    "learned_opening", "learned_force", "learned_leakage", "learned_flow", "learned_torque", "learned_supply",
    "learned_return",
)  # fmt: skip
#: packages may offer effects of their own under this entry point group
ENTRY_POINTS = "crane_exudyn.effects"

_user_effects: list[type[Effect]] = []
_user_files: list[Path] = []
_frozen = False


@cache
def _built_in() -> tuple[type[Effect], ...]:
    return tuple(_effects_of(importlib.import_module(f".{name}", __package__))[0] for name in BUILT_IN)


@cache
def _installed() -> tuple[type[Effect], ...]:
    return tuple(checked(point.load(), point.value) for point in entry_points(group=ENTRY_POINTS))


def known() -> tuple[type[Effect], ...]:
    """Return all effects: built in, installed through entry points, and the user's own."""
    return (*_built_in(), *_installed(), *_user_effects)


def find(name: str) -> type[Effect]:
    """Return the effect of that name; the error names the nearest known one."""
    for effect in known():
        if effect.name == name:
            return effect
    raise CraneError(
        f"There is no effect {name!r}.{nearest(name, [e.name for e in known()])} `patu effects` lists all. Read "
        "your own effects from their file with --effects or crane_exudyn.load_effects."
    )


def split_key(key: str, layout: Layout | None = None) -> tuple[type[Effect], str]:
    """Return effect and place of "name@place" (or "name" for an effect of the whole machine).

    Raises:
        CraneError: unknown effect, no place where one is needed, or one that the machine of the layout (if given) does
            not have.
    """
    name, _, place = key.partition("@")
    effect = find(name)
    if layout is not None and not place and not effect.places and not effect.on(layout):
        raise CraneError(
            f"Effect {name!r} acts on a payload, and the machine has none: [payload] gives no body and at."
        )
    if (not place) != (not effect.places) or (layout is not None and place not in effect.on(layout)):
        raise _misplaced(effect, place, layout)
    return effect, place


def _misplaced(effect: type[Effect], place: str, layout: Layout | None) -> CraneError:
    """Return the error on a place at which an effect cannot act ("" for none), with an example."""
    if not effect.places:
        return CraneError(f"Effect {effect.name!r} acts on the whole machine, not at {place!r}. Write {effect.name}.")
    places = effect.on(layout) if layout else ()
    known = ", ".join(places) if layout else f"the machine's {effect.places}"
    found = f"cannot act at {place!r}" if place else "needs a place"
    if not places:
        return CraneError(f"Effect {effect.name!r} {found}. Places: {known or 'none on this machine'}.")
    close = difflib.get_close_matches(place, places, n=1)
    return CraneError(f"Effect {effect.name!r} {found}. Places: {known}. Write {effect.name}@{(close or places)[0]}.")


def in_words(key: str) -> str:
    """Return effects as people say them: "internal leakage (lift)" of "internal_leakage@lift", several joined by " +
    ".
    """
    said = []
    for part in key.split(" + "):
        name, _, place = part.partition("@")
        said.append(name.replace("_", " ") + (f" ({place})" if place else ""))
    return " + ".join(said)


def all_keys(layout: Layout) -> list[str]:
    """Return "name@place" of every effect at every place of a machine."""
    return [key for effect in known() for key in effect.keys(layout)]


@cache
def starts() -> dict[str, int]:
    """Return where in E the parameters of each effect begin: those of one place after those of another."""
    found, start = {}, 0
    for effect in known():
        found[effect.name] = start
        start += len(effect.parameters) * MOST[effect.places]
    return found


def slot(name: str, place: str, layout: Layout) -> int:
    """Return where in E the first parameter of an effect at a place of a machine stands."""
    effect = find(name)
    return starts()[name] + len(effect.parameters) * layout.place_number(effect.places, place)


@cache
def slots_of(hooks: frozenset[str], *, only: bool = False) -> np.ndarray:
    """Return where in E the parameters of all effects stand that have some of these hooks; `only`: and no others."""
    found = [
        starts()[effect.name] + i
        for effect in known()
        if (set(effect.hooks()) <= hooks if only else set(effect.hooks()) & hooks)
        for i in range(len(effect.parameters) * MOST[effect.places])
    ]
    return np.array(found, np.int64)


@cache
def _neutral() -> tuple[float, ...]:
    return tuple(p.neutral for effect in known() for _ in range(MOST[effect.places]) for p in effect.parameters)


def neutral_vector() -> list[float]:
    """Return E with every effect switched off."""
    return list(_neutral())


@cache
def events() -> tuple[tuple[slice, int, tuple[float, ...]], ...]:
    """Return of each effect with a moment (`Parameter.moment`), at each place, where in E its parameters stand, where
    the moment does, and the neutral values.
    """
    found = []
    for effect in known():
        n, neutral = len(effect.parameters), tuple(p.neutral for p in effect.parameters)
        for at in (i for i, p in enumerate(effect.parameters) if p.moment):
            first = starts()[effect.name]
            found += [(slice(k, k + n), k + at, neutral) for k in range(first, first + n * MOST[effect.places], n)]
    return tuple(found)


@cache
def slots_of_events() -> np.ndarray:
    """Return where in E the parameters of effects with a moment stand."""
    return np.concatenate([np.arange(own.start, own.stop) for own, _, _ in events()])


def register(effect: type[Effect]) -> type[Effect]:
    """Make a user's own effect known; may be used as a class decorator.

    Compiled code contains every effect, so this must come before the first engine is imported.
    """
    checked(effect, str(getattr(inspect.getmodule(effect), "__file__", effect.__module__)))
    try:
        _source(effect)
    except (OSError, TypeError) as problem:
        raise CraneError(
            f"Effect {effect.name!r} is not defined in a file, which compiled code needs to identify it. Write it to a "
            "Python file, and read that with crane_exudyn.load_effects(FILE)."
        ) from problem
    if any(e.name == effect.name for e in known()):
        raise CraneError(f"There is an effect {effect.name!r} already. Give yours another name.")
    if _frozen:
        raise CraneError(
            f"Effect {effect.name!r} is loaded too late: modules that are compiled with all effects are already there. "
            "Call crane_exudyn.load_effects(FILE) before other imports of crane_exudyn, ukf and validation; in a "
            "notebook, restart it."
        )
    _user_effects.append(effect)
    for table in (starts, slots_of, _neutral, events, slots_of_events):
        table.cache_clear()
    return effect


def load_effects(path: str | Path) -> list[type[Effect]]:
    """Register every effect that a Python file defines, and return them; nothing if the file has been read before.

    Compiled code contains every effect, so this comes before the imports of anything that is compiled: all of
    crane_exudyn but Crane and Recording, ukf and validation.

    Raises:
        CraneError: the file cannot be read or defines no effect, an effect is not as it must be, or it comes too late.
    """
    file = named_file(path, "load_effects").resolve()
    if file in _user_files:
        return []
    if not file.is_file():
        raise CraneError(f"{file}: there is no such file. --effects needs a Python file that defines an Effect.")
    if file.suffix != ".py":
        raise CraneError(f"{file}: this is not a Python file. --effects needs a file NAME.py that defines an Effect.")
    # the folder is in the name: files of one name in two folders are two modules, and compiled code refers to them by
    # name
    folder = hashlib.sha256(str(file.parent).encode()).hexdigest()[:8]
    spec = importlib.util.spec_from_file_location(f"user_effects_{file.stem}_{folder}", file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = (
        module  # so that its source can be found: worker processes and the cache of compiled code need it
    )
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as problem:
        raise CraneError(f"{file}: cannot be imported: {problem!r}.") from problem
    found = _effects_of(module)
    if not found:
        raise CraneError(
            f"{file}: defines no effect. Write a class that derives from crane_exudyn.effects.base.Effect."
        )
    registered = [register(e) for e in found]
    _user_files.append(file)
    return registered


def user_files() -> tuple[Path, ...]:
    """Return the files that `load_effects` has registered effects from, for worker processes to do the same."""
    return tuple(_user_files)


def _effects_of(module: object) -> list[type[Effect]]:
    classes = [c for c in vars(module).values() if inspect.isclass(c) and issubclass(c, Effect) and c is not Effect]
    return [c for c in classes if c.__module__ == module.__name__]  # type: ignore[attr-defined]


def freeze() -> None:
    """Say that compiled code is about to be made from the effects that are known now."""
    global _frozen
    _frozen = True


def fingerprint() -> str:
    """Return a text that differs when the set of effects, or the module or source of a user's effect differs."""
    texts = []
    for effect in (*_installed(), *_user_effects):
        texts += [effect.__module__, _source(effect)]
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()


def _source(effect: type[Effect]) -> str:
    """Return the text of the module that defines an effect. Raises OSError or TypeError where it is in no file."""
    return inspect.getsource(inspect.getmodule(effect))  # type: ignore[arg-type]
