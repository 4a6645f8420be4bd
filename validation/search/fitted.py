"""One effect, chosen by the user, fitted to a recording together with the nominal parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.effects import registry
from crane_exudyn.errors import CraneError
from crane_exudyn.recording import Recording
from crane_exudyn.vetting import vetted

from ..fit.data import FitData
from ..fit.staged import LOOSE, STIFF, TIGHT, all_parameters, informed_directions
from ..fit.variables import Variable, effect_variables
from ..history import added
from .candidates import scaled, starts
from .screen import screen
from .weigh import Hypothesis, at_bound, deviations, fitted_values, open_loop_error, weigh


def helped(document: Mapping[str, Any]) -> bool:
    """Return whether a fit, as `fitted_effect` tells of it, made the open-loop error smaller with a likelihood that exists."""
    return bool(np.isfinite(document["evidence"]) and document["error_after"] < document["error_before"])


def fitted_effect(
    crane: Crane, key: str, recording: Recording, values: Mapping[str, float]
) -> tuple[Crane, dict[str, Any]]:
    """Return the crane with an effect fitted from every start that the effect offers, and what the fit found.

    Raises:
        CraneError: no such effect, the crane has it already, or the recording cannot be true.
    """
    if registry.split_key(key, crane.layout)[0].curve is not None:
        raise CraneError(f"{key!r} is a curve, which has no typical size to be fitted from. Find it with `patu learn`.")
    if crane.effect(key) is not None:
        raise CraneError(
            f"{crane.name} has {key!r} already. Remove it first, or fit everything anew with `patu improve`."
        )
    recording = vetted(recording, crane)
    data = FitData.of(recording, crane)
    base = all_parameters(crane, data)
    own: list[Variable] = [v for e in crane.effects for v in effect_variables(e.key, e.parameters, crane.layout)]
    shared = [*informed_directions(base), *own]
    begins = [
        scaled(s.start, s.amplitude) for s in screen(base, [s for s in starts(crane, data) if s.key == key], 1.0)[:2]
    ]
    begins = [dict(values)] if values else begins
    loose = [weigh(crane, data, shared, base, Hypothesis({key: b}), (LOOSE,)) for b in begins]
    if not loose:
        raise CraneError(f"{recording.name} says nothing about {key!r}: no channel shows it.")
    best = max(loose, key=lambda w: w.evidence)
    done = weigh(crane, data, shared, best.fit, best.hypothesis, (TIGHT, STIFF))
    before, _ = open_loop_error(crane, recording)
    after, _ = open_loop_error(done.fit.crane, recording)
    found, spread = fitted_values(done, key), deviations(done, key)
    document = {
        "parameters": {n: {"value": v, "std": spread.get(n)} for n, v in found.items()},
        "evidence": done.evidence, "error_before": before, "error_after": after, "at_bound": at_bound(done, key),
    }  # fmt: skip
    evidence = {"recording": recording.name, "evidence": done.evidence, "error_before": before, "error_after": after}
    return added(crane, done.fit.crane, **evidence), document
