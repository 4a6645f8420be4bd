"""`patu effects`: what physical effects there are, their laws and parameters."""

from __future__ import annotations

import inspect
import math
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import DEFAULT_CRANE, CraneOption, EffectsOption, JsonOption
from .output import Printer
from .outputs import saving
from .reading import load_crane

if TYPE_CHECKING:
    from crane_exudyn.effects.base import Effect
    from crane_exudyn.effects.curve import Curve
    from crane_exudyn.layout import Layout


def command(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="One effect; all if left out.")] = None,
    crane: CraneOption = DEFAULT_CRANE,
    effects: EffectsOption = None,
    json: JsonOption = None,
) -> None:
    """List the physical effects that a model may lack, or show one: law, signature, parameters, places."""
    from crane_exudyn.effects import registry

    layout = load_crane(crane, effects).layout
    chosen = [registry.find(name.partition("@")[0])] if name else list(registry.known())
    printer = Printer(json)
    if name:
        tell(printer, chosen[0], layout)
    else:
        rows = [(e.name, _places(e, layout), _parameters(e), e.law()) for e in chosen]
        printer.table("", ("effect", "places", "parameters", "what it is"), rows)
        printer.line("`patu effects NAME` shows one of them in full.")
    with saving(printer) as save:
        save.json(json, [describe(effect, layout) for effect in chosen])


def _parameters(effect: type[Effect]) -> str:
    """Return the names of an effect's parameters, or what its curve may run over."""
    if effect.curve is not None:
        return "curve over " + ", ".join(a.name for a in effect.curve.over)
    return ", ".join(p.name for p in effect.parameters)


def describe(effect: type[Effect], layout: Layout) -> dict[str, Any]:
    """Return one effect on a machine for the JSON result; a neutral value of null is infinite."""
    parameters = [
        {"name": p.name, "unit": p.unit, "neutral": p.neutral, "lower": p.lower, "upper": p.upper, "text": p.text}
        for p in effect.parameters
    ]
    described = {
        "name": effect.name,
        "places": list(effect.on(layout)),
        "text": inspect.cleandoc(effect.__doc__ or ""),
        "parameters": parameters,
    }
    if effect.curve is None:
        return described
    over = [{"name": a.name, "unit": a.unit, "against_motion": list(a.against)} for a in effect.curve.over]
    return described | {"parameters": [], "curve": {"unit": effect.curve.unit, "over": over}}


def tell(printer: Printer, effect: type[Effect], layout: Layout) -> None:
    """Print one effect: its docstring, where it may act on a machine, its parameters."""
    printer.line(f"{effect.name} - {inspect.cleandoc(effect.__doc__ or '')}")
    printer.line(f"\nPlaces: {_places(effect, layout)}")
    if effect.curve is not None:
        _tell_curve(printer, effect.curve)
        return
    rows = [
        (p.name, p.unit or "-", "shape" if p.shape else _number(p.neutral), f"{p.lower:g} … {p.upper:g}", p.text)
        for p in effect.parameters
    ]
    printer.table("", ("parameter", "unit", "neutral", "range", "meaning"), rows)
    key = next(iter(effect.keys(layout)), effect.name)
    printer.line(f"patu add {key} --fit REC -o new.toml   adds it to a crane file, with fitted parameters.")


def _tell_curve(printer: Printer, curve: Curve) -> None:
    """Print what the curve of an effect may run over, and what it is found with."""
    rows = [
        (a.name, a.unit or "-", curve.unit or "-", " or ".join(_ACTS[kind] for kind in a.against)) for a in curve.over
    ]
    printer.table("", ("over", "unit of x", "unit of y", "acts"), rows)
    printer.line("patu learn REC -o new.toml   finds such a curve. In a crane file it is a table with over, x and y.")


_ACTS = {True: "against motion", False: "with its own sign"}


def _places(effect: type[Effect], layout: Layout) -> str:
    return " ".join(p or "whole machine" for p in effect.on(layout)) or "none on this machine"


def _number(value: float) -> str:
    return "∞" if math.isinf(value) else f"{value:g}"
