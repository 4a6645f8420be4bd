"""What a search takes for granted of recordings, and how a fitted model shows that it is otherwise.

Noise is taken as white; commands between samples as lines, but for steps, which come with the sample that shows them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import cycle
from typing import NamedTuple

import numpy as np

from crane_exudyn.channels import JUST_BEFORE, Channel
from crane_exudyn.drive import Step
from crane_exudyn.recording import Recording
from crane_exudyn.signals import shared_part, shown_of

from ..criteria import CRITERIA
from ..fit.columns import Columns, pack
from ..fit.data import FitData, noise_of
from ..fit.model import Model as Inputs
from ..fit.model import model_of
from ..fit.solve import Fit, bounded_step
from ..fit.staged import STIFF
from .levels import noise_in_full
from .model import Fitted, Model, fitted, open_loop_error, unmoving
from .screen import projected
from .search import Problem

#: share of the sampling interval by which a step is shifted to see what that does
_SHIFT = 0.5
#: what may be otherwise: what finds it, what is then, in words, a note
_Kind = tuple[Callable[[Problem, Fitted], tuple[Problem, Fitted] | None], str, str]


class Otherwise(NamedTuple):
    """A problem as a fitted model shows it, and that model fitted so; what is other, in words and as notes."""

    problem: Problem
    found: Fitted
    words: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def text(self) -> str:
        """What is done with it, as progress tells it."""
        return f"looking for effects, with {' and '.join(self.words)}"


def otherwise(problem: Problem, found: Fitted) -> Otherwise | None:
    """Return the problem with the noise and the commands between samples that a fitted model shows; None where these
    are as they were taken.
    """
    return _as_shown(problem, found, _OTHERWISE)


def before_search(problem: Problem, found: Fitted) -> Otherwise | None:
    """Return the same as the machine without effects shows it: all of it where that leaves only noise then, else the
    noise alone, which is told by samples that the model explains.
    """
    other = otherwise(problem, found)
    return other if other is None or other.found.good else _as_shown(problem, found, _OTHERWISE[:1])


def _as_shown(problem: Problem, found: Fitted, kinds: Sequence[_Kind]) -> Otherwise | None:
    now, settled = Otherwise(problem, found), 0
    for taken, words, note in cycle(kinds):  # noise shows where steps are explained, and steps where noise is
        if settled == len(kinds):
            break
        again = taken(now.problem, now.found)
        settled = settled + 1 if again is None else 1
        if again is not None:
            told = words not in now.words
            now = Otherwise(*again, now.words + (words,) * told, now.notes + (note,) * told)
    return now if now.words else None


def alike(problem: Problem, found: Fitted, check: Recording | None) -> Recording | None:
    """Return another recording of the machine, its commands taken as those of the problem's: where these step between
    two samples, so do its, at the moments that are likeliest with the crane as it was fitted, which it does not change.
    """
    if check is None:
        return None
    first = problem.recordings[0]
    check = replace(check, held=check.held or first.held, memory=first.memory)
    shares = [r.early[step] / h for r in problem.recordings if r.early for step, h in r.steps(problem.crane).items()]
    if not shares:
        return check
    early = {step: float(np.mean(shares)) * h for step, h in check.steps(problem.crane).items()}
    crane = found.fit.crane
    if problem.data.own:  # what differs from recording to recording is the check's own, too
        crane = open_loop_error(crane, check, own=problem.data.own)[1].crane
    crane = unmoving(replace(crane, sensors=problem.crane.sensors))
    own = Problem.of(crane, [replace(check, early=early, vouched=True)], (), problem.jobs)
    now = own, fitted(crane, own.data, Model(()), own.nominal, (STIFF,))
    return replace(_at_their_moments(*now)[0].recordings[0], vouched=check.vouched)


def noisier(problem: Problem, w: Fitted) -> tuple[Problem, Fitted] | None:
    """Return the problem with the noise that sensors have in full, where it is alike from one sample to the next and
    was estimated too small; None where a fitted model does not show that.
    """
    shown, sensors = [noise_of(r, problem.crane) for r in problem.recordings], dict(problem.crane.sensors)
    memories = [dict(r.memory) for r in problem.recordings]
    averaged = [{s.channel: s.averaged for s in part.samples} for part in problem.data.parts]
    for channel, factors in noise_in_full(w.fit, problem.data).items():
        having = [i for i, noise in enumerate(shown) if channel in noise]
        each = [shown[i][channel] for i in having]
        if np.mean(factors) > 1.0 and max(each) < CRITERIA.left_level * min(each):  # one file states one noise for all
            shared = [shared_part(f, averaged[i][channel]) for f, i in zip(factors, having, strict=True)]
            sensors[channel] = float(np.mean(each / shown_of(np.array(shared))))
            for i, part in zip(having, shared, strict=True):
                memories[i][channel] = _memory(problem.recordings[i][channel], part)
    if sensors == problem.crane.sensors:
        return None
    recordings = [replace(r, memory=own) for r, own in zip(problem.recordings, memories, strict=True)]
    other = Problem.of(replace(problem.crane, sensors=sensors), recordings, problem.data.own, problem.jobs)
    return other, fitted(other.crane, other.data, w.model, w.fit, (STIFF,))


def _memory(channel: Channel, shared: float) -> float:
    """Return the time in s after which samples share 1/e of their noise, where neighbours share a part of it."""
    return float(np.median(np.diff(channel.time))) / -math.log(max(shared, 1e-9))


def stepped(problem: Problem, w: Fitted) -> tuple[Problem, Fitted] | None:
    """Return the problem with steps of commands at their likeliest moments between two samples; None where a fitted
    model is not clearly likelier so.
    """
    found = _at_their_moments(problem, w)
    return _told(found) if found[1] is not w else None


def _at_their_moments(problem: Problem, w: Fitted) -> tuple[Problem, Fitted]:
    """Return the problem with steps of commands at the moments that a fitted model shows, and that model fitted so, as
    long as it becomes clearly likelier.
    """
    now = problem, w
    while (again := _driven_by(_with_likeliest_steps(now[1].fit, now[0].recordings), *now)) is not None:
        now = again
    return now


def held(problem: Problem, w: Fitted) -> tuple[Problem, Fitted] | None:
    """Return the problem with commands that keep their value until the next sample, as a controller puts them out; None
    where a fitted model is not clearly likelier so.
    """
    return _told(_driven_by([replace(r, held=True) for r in problem.recordings], problem, w))


def _driven_by(recordings: Sequence[Recording], problem: Problem, w: Fitted) -> tuple[Problem, Fitted] | None:
    """Return the problem with recordings whose commands are other ones between samples; None where a fitted model is
    not clearly likelier so, or promises not to be.
    """
    other = Problem.of(problem.crane, recordings, problem.data.own, problem.jobs)
    same = all(_same_commands(a, b) for a, b in zip(other.data.parts, problem.data.parts, strict=True))
    if same or _promise(w.fit, other.data.parts) < CRITERIA.tie:
        return None
    again = fitted(problem.crane, other.data, w.model, w.fit, (STIFF,))
    return (other, again) if again.evidence > w.evidence + CRITERIA.proof else None


def _same_commands(a: FitData, b: FitData) -> bool:
    return np.array_equal(a.command_time, b.command_time) and np.array_equal(a.commands, b.commands)


def _promise(fit: Fit, others: Sequence[FitData]) -> float:
    """Return by how much the cost is to fall where a fit is driven by the commands of others, one for each recording,
    with all that it moves free to follow; nothing where the model fails.
    """

    def probe(base: Inputs, data: FitData, recording: int) -> Columns:
        other = others[recording]
        return pack(base, [_driven(base, data, other.command_time, other.commands)], np.ones(1))

    found = projected(fit, fit.knots, probe, STIFF.stiffness)
    return 0.0 if found is None else -float(found.g[0] + 0.5 * found.H[0, 0])


def _driven(base: Inputs, data: FitData, time: np.ndarray, commands: np.ndarray) -> Inputs:
    """Return a model driven by other commands (n, valves) at times (n,) in s."""
    return model_of(base.crane, replace(data, command_time=time, commands=commands), base.late)


def _told(found: tuple[Problem, Fitted] | None) -> tuple[Problem, Fitted] | None:
    """Return what was found, None where so much is left that what it gains tells nothing of the commands."""
    return found if found is not None and found[1].level < CRITERIA.left_level else None


_OTHERWISE: tuple[_Kind, ...] = (
    (
        noisier,
        "the noise that neighbouring samples share",
        "sensors are noisier than neighbouring samples differ, because these share a part of the noise, as where a "
        "logger smooths: errors are told in units of all of the noise",
    ),
    (
        stepped,
        "commands that step between samples",
        "commands step between two samples: when was fitted, for recordings do not tell",
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
    now = np.array([recordings[i].early.get(step, 0.0) / interval for i, step, interval in each])
    shifts = np.where(now < _SHIFT, _SHIFT, -_SHIFT)

    def probes(base: Inputs, data: FitData, recording: int) -> Columns:
        moved = []
        for (i, step, interval), share in zip(each, now + shifts, strict=True):
            if i == recording:
                r = recordings[i]
                stepping = replace(r, early={**r.early, step: share * interval})
                moved.append(_driven(base, data, *stepping.commands(fit.crane)))
            else:
                moved.append(base)
        return pack(base, moved, shifts)

    found = projected(fit, fit.knots, probes, STIFF.stiffness) if each else None
    if found is None:
        return list(recordings)
    shares = now + bounded_step(found.H, found.g, now, np.zeros(len(each)), np.ones(len(each)), 0.0)
    early: list[dict[Step, float]] = [{} for _ in recordings]
    for (i, step, interval), share in zip(each, shares.tolist(), strict=True):
        early[i][step] = share * (interval - 2.0 * JUST_BEFORE)
    return [replace(r, early=own) for r, own in zip(recordings, early, strict=True)]
