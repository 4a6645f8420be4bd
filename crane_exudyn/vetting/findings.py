"""What a check reports about a recording, and what becomes of it: notes, or an error that stops the recording's use."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

from ..crane import Crane
from ..errors import CraneError
from ..mapping import Column
from ..recording import Recording

Severity = Literal["error", "warning", "note"]
Kind = Literal["sign", "swapped", "absolute", "scale", "offset", "clock", "pose", "noise", "saturation", "motion"]

_WORST_FIRST: tuple[Severity, ...] = ("error", "warning", "note")


@dataclass(frozen=True, eq=False)
class Finding:
    """Something that a check found in a recording.

    Attributes:
        kind: what is wrong;  channels: where.
        severity: "error" cannot be true, "warning" is hardly true, "note" is worth knowing.
        text: what was found;  mend: how to correct it.
        columns: what the channels should be read from, where that corrects it.
    """

    kind: Kind
    channels: tuple[str, ...]
    severity: Severity
    text: str
    mend: str
    columns: Mapping[str, Column] = field(default_factory=dict, repr=False)

    @property
    def sentences(self) -> str:
        """What was found and how to correct it."""
        return f"{self.text}. {self.mend}"


#: one look at a recording of a crane
Check = Callable[[Recording, Crane], Iterator[Finding]]


def worst_first(findings: Iterable[Finding]) -> list[Finding]:
    """Return findings by severity; those of the same severity stay in order."""
    return sorted(findings, key=lambda f: _WORST_FIRST.index(f.severity))


def blamed(findings: Iterable[Finding]) -> set[str]:
    """Return the channels of the findings that are errors."""
    return {n for f in findings if f.severity == "error" for n in f.channels}


def accepted(recording: Recording, findings: Iterable[Finding], *, anyway: bool = False) -> Recording:
    """Return the recording with its findings as notes.

    Raises:
        CraneError: some findings are errors, and the recording is not to be used `anyway`.
    """
    found = tuple(findings)
    errors = [f.sentences for f in found if f.severity == "error"]
    if errors and not anyway:
        raise CraneError(f"{recording.source or recording.name}: {' '.join(errors)}")
    notes = (*recording.notes, *(f.sentences.removesuffix(".") for f in found))
    return replace(recording, notes=notes, vouched=True)
