"""One effect, chosen by the user, fitted to a recording together with the nominal parameters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.recording import Recording
from crane_exudyn.vetting import vetted

from ..criteria import CRITERIA
from ..fit.staged import LOOSE, STIFF, TIGHT
from ..history import addable, added
from .model import Model, at_bound, fitted, open_loop_error
from .moves import scaled, starts
from .screen import screen
from .search import Problem


def helped(document: Mapping[str, Any]) -> bool:
    """Return whether a fit, as `fitted_effect` tells of it, made the open-loop error smaller, and is clearly likelier
    than one of the parameters alone.
    """
    likelier = bool(document["evidence"] >= document["evidence_without"] + CRITERIA.proof)
    return likelier and math.isfinite(document["evidence"]) and document["error_after"] < document["error_before"]


def fitted_effect(
    crane: Crane, key: str, recording: Recording, values: Mapping[str, float]
) -> tuple[Crane, dict[str, Any]]:
    """Return the crane with an effect fitted from every start that the effect offers, and what the fit found.

    Raises:
        CraneError: as `addable`, or the recording cannot be true.
    """
    addable(crane, key)
    recording = vetted(recording, crane)
    problem = Problem.of(crane, [recording], (), jobs=1)
    offered = [s for s in starts(crane, problem.data) if s.key == key]
    begins = [scaled(s.start, s.amplitude) for s in screen(problem.base, offered, LOOSE.stiffness)[:2]]
    begins = [dict(values)] if values else begins
    loose = [fitted(crane, problem.data, Model(problem.shared, {key: b}), problem.base, (LOOSE,)) for b in begins]
    if not loose:
        raise CraneError(f"{recording.name} contains no information on {key!r}: no channel responds to it.")
    best = max(loose, key=lambda w: w.evidence)
    done = fitted(crane, problem.data, best.model, best.fit, (TIGHT, STIFF))
    plain = fitted(crane, problem.data, Model(problem.shared), problem.base, (TIGHT, STIFF))
    before, _ = open_loop_error(crane, recording)
    after, _ = open_loop_error(done.fit.crane, recording)
    without, _ = open_loop_error(plain.fit.crane, recording)
    found, spread = done.values(key), done.deviations(key)
    document = {
        "parameters": {n: {"value": v, "std": spread.get(n)} for n, v in found.items()},
        "evidence": done.evidence, "error_before": before, "error_after": after, "error_without": without,
        "evidence_without": plain.evidence, "at_bound": at_bound(done.fit, key),
    }  # fmt: skip
    evidence = {"recording": recording.name, "evidence": done.evidence, "error_before": before, "error_after": after}
    return added(crane, done.fit.crane, **evidence), document
