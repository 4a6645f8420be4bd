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

from ..criteria import CRITERIA
from ..fit.staged import LOOSE, STIFF, TIGHT
from ..history import added
from .model import Model, at_bound, fitted, open_loop_error
from .moves import scaled, starts
from .screen import screen
from .search import Problem


def helped(document: Mapping[str, Any]) -> bool:
    """Return whether a fit, as `fitted_effect` tells of it, made the open-loop error smaller with a likelihood that
    exists, and whether the effect had a part in that which is more than chance.
    """
    if not (np.isfinite(document["evidence"]) and document["error_after"] < document["error_before"]):
        return False
    without, after = document["error_without"], document["error_after"]
    return bool(document["samples"] * ((without / after) ** 2 - 1.0) > CRITERIA.told_apart**2)


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
    problem = Problem.of(crane, [recording], (), jobs=1)
    offered = [s for s in starts(crane, problem.data) if s.key == key]
    begins = [scaled(s.start, s.amplitude) for s in screen(problem.base, offered, LOOSE.stiffness)[:2]]
    begins = [dict(values)] if values else begins
    loose = [fitted(crane, problem.data, Model(problem.shared, {key: b}), problem.base, (LOOSE,)) for b in begins]
    if not loose:
        raise CraneError(f"{recording.name} says nothing about {key!r}: no channel shows it.")
    best = max(loose, key=lambda w: w.evidence)
    done = fitted(crane, problem.data, best.model, best.fit, (TIGHT, STIFF))
    before, _ = open_loop_error(crane, recording)
    after, _ = open_loop_error(done.fit.crane, recording)
    without, _ = open_loop_error(done.fit.crane.without_effect(key), recording)
    found, spread = done.values(key), done.deviations(key)
    document = {
        "parameters": {n: {"value": v, "std": spread.get(n)} for n, v in found.items()},
        "evidence": done.evidence, "error_before": before, "error_after": after, "error_without": without,
        "samples": sum(len(recording[n]) for n in recording.sensors), "at_bound": at_bound(done.fit, key),
    }  # fmt: skip
    evidence = {"recording": recording.name, "evidence": done.evidence, "error_before": before, "error_after": after}
    return added(crane, done.fit.crane, **evidence), document
