"""Whether a recording is what it says it is: findings, each with its correction.

    for finding in vet(recording, crane):
        print(finding.severity, finding.text, finding.mend)

Samples that were not measured are reported first (`strays`), and the rest is looked at without them, so that a single
spike is not taken for a wrong unit. What no crane can do (`impossible`), and how well the recording was taken
(`quality`), is seen in single channels. Whether a channel is another one, or has another sign, unit, reference or
clock, is seen in the balances (`disagreements`): they close far better if it is read otherwise (`readings`, `clocks`),
which no wear of a machine makes them do.
"""

from __future__ import annotations

from ..crane import Crane
from ..recording import Recording
from . import impossible, quality
from .disagreements import disagreements
from .findings import Finding, accepted, blamed, worst_first
from .strays import without_strays


def vet(recording: Recording, crane: Crane) -> list[Finding]:
    """Return what is implausible about a recording of a crane, worst first; empty for a sound one."""
    measured, unmeasured = without_strays(recording, crane)
    disagreeing = disagreements(measured, crane)
    explained = {n for f in disagreeing for n in f.channels}  # what a channel is, says more than that it cannot be
    single = [f for f in _single_channels(measured, crane) if not explained.intersection(f.channels)]
    return worst_first([*unmeasured, *disagreeing, *single])


def contents(recording: Recording, crane: Crane) -> list[Finding]:
    """Return what cannot be true of single channels, or hardly, worst first; in well under a second."""
    measured, unmeasured = without_strays(recording, crane)
    return worst_first([*unmeasured, *_single_channels(measured, crane)])


def _single_channels(recording: Recording, crane: Crane) -> list[Finding]:
    found: list[Finding] = []
    for check in (*impossible.CHECKS, *quality.CHECKS):
        for finding in check(recording, crane):
            if not blamed(found).intersection(finding.channels):  # one reason is enough
                found.append(finding)
    return found


def vetted(recording: Recording, crane: Crane) -> Recording:
    """Return the recording with notes on what is hardly plausible about its contents; unchanged if it was accepted
    before.

    Raises:
        CraneError: something in it cannot be true; all such findings, each with its correction.
    """
    return recording if recording.vouched else accepted(recording, contents(recording, crane))
