"""What a search takes for granted of recordings, and how a fitted model shows that it is otherwise.

Noise is taken as white; commands between samples as lines, but for steps, which come with the sample that shows them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from crane_exudyn.channels import JUST_BEFORE
from crane_exudyn.drive import Step
from crane_exudyn.recording import Recording

from ..criteria import CRITERIA
from ..fit.columns import Columns, pack
from ..fit.data import FitData, noise_of
from ..fit.model import Model, model_of
from ..fit.solve import Fit, bounded_step
from ..fit.staged import STIFF
from .levels import noise_in_full
from .model import Fitted, fitted
from .screen import projected
from .search import Problem

#: share of the sampling interval by which a step is shifted to see what that does
_SHIFT = 0.5


class Otherwise(NamedTuple):
    """A problem as a fitted model shows it, and that model fitted so; what is other, in words and as notes."""

    problem: Problem
    found: Fitted
    words: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def otherwise(problem: Problem, found: Fitted) -> Otherwise | None:
    """Return the problem with the noise and the commands between samples that a fitted model shows; None where these
    are as they were taken.
    """
    now = Otherwise(problem, found)
    for taken, words, note in _OTHERWISE:
        if (again := taken(now.problem, now.found)) is not None:
            now = Otherwise(*again, (*now.words, words), (*now.notes, note))
    return now if now.words else None


def noisier(problem: Problem, w: Fitted) -> tuple[Problem, Fitted] | None:
    """Return the problem with the noise that sensors have in full, where it is alike from one sample to the next and
    was estimated too small; None where a fitted model does not show that.
    """
    shown, sensors = [noise_of(r, problem.crane) for r in problem.recordings], dict(problem.crane.sensors)
    for channel, factor in noise_in_full(w.fit, problem.data).items():
        each = [noise[channel] for noise in shown if channel in noise]
        if factor > 1.0 and max(each) < CRITERIA.left_level * min(each):  # one file states one noise for all
            sensors[channel] = factor * float(np.mean(each))
    if sensors == problem.crane.sensors:
        return None
    other = Problem.of(replace(problem.crane, sensors=sensors), problem.recordings, problem.data.own, problem.jobs)
    return other, fitted(other.crane, other.data, w.model, w.fit, (STIFF,))


def stepped(problem: Problem, w: Fitted) -> tuple[Problem, Fitted] | None:
    """Return the problem with steps of commands at their likeliest moments between two samples; None where a fitted
    model is not clearly likelier so.
    """
    return _driven_by(_with_likeliest_steps(w.fit, problem.recordings), problem, w)


def held(problem: Problem, w: Fitted) -> tuple[Problem, Fitted] | None:
    """Return the problem with commands that keep their value until the next sample, as a controller puts them out; None
    where a fitted model is not clearly likelier so.
    """
    return _driven_by([replace(r, held=True) for r in problem.recordings], problem, w)


def _driven_by(recordings: Sequence[Recording], problem: Problem, w: Fitted) -> tuple[Problem, Fitted] | None:
    """Return the problem with recordings whose commands are other ones between samples; None where a fitted model is
    not clearly likelier so, or leaves so much that what it gains tells nothing of the commands.
    """
    other = Problem.of(problem.crane, recordings, problem.data.own, problem.jobs)
    if all(np.array_equal(a.commands, b.commands) for a, b in zip(other.data.parts, problem.data.parts, strict=True)):
        return None
    again = fitted(problem.crane, other.data, w.model, w.fit, (STIFF,))
    likelier = again.evidence > w.evidence + CRITERIA.proof and again.level < CRITERIA.left_level
    return (other, again) if likelier else None


#: what may be otherwise: what is then, in words, a note
_OTHERWISE = (
    (
        noisier,
        "the noise that neighbouring samples share",
        "sensors are noisier than neighbouring samples differ, because these share a part of the noise, as where a "
        "logger smooths: errors are told in units of all of the noise",
    ),
    (
        stepped,
        "commands that step between samples",
        "commands step between two samples: when was fitted, for the recording does not tell",
    ),
    (
        held,
        "commands that keep their value until the next sample",
        "commands seem to keep their value until the next sample: set held = true in a map file",
    ),
)


def _with_likeliest_steps(fit: Fit, recordings: Sequence[Recording]) -> list[Recording]:
    """Return the recordings of a fit, each step of a command where it explains most of what the fit leaves, with all
    that the fit moves free to follow; as they are, where the model fails.

    What a shift does is taken as proportional to it.
    """
    each = [(i, *step) for i, r in enumerate(recordings) for step in r.steps(fit.crane).items()]

    def probes(base: Model, data: FitData, recording: int) -> Columns:
        moved = []
        for i, step, interval in each:
            if i == recording:
                r = recordings[i]
                time, commands = replace(r, early={**r.early, step: _SHIFT * interval}).commands(fit.crane)
                moved.append(model_of(base.crane, replace(data, command_time=time, commands=commands), base.late))
            else:
                moved.append(base)
        return pack(base, moved, np.full(len(moved), _SHIFT))

    found = projected(fit, fit.knots, probes, STIFF.stiffness) if each else None
    if found is None:
        return list(recordings)
    none, all_of_it = np.zeros(len(each)), np.ones(len(each))
    shares = bounded_step(found.H, found.g, none, none, all_of_it, 0.0)
    early: list[dict[Step, float]] = [{} for _ in recordings]
    for (i, step, interval), share in zip(each, shares.tolist(), strict=True):
        early[i][step] = share * (interval - 2.0 * JUST_BEFORE)
    return [replace(r, early=own) for r, own in zip(recordings, early, strict=True)]
