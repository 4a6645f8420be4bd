"""One parameter of an effect."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect.

    Attributes:
        name: the key in crane files and JSON.
        unit: SI, as pint writes it; "" for a pure number; "channel" for the unit of the sensor it acts on.
        neutral: the value that switches the effect off (all parameters neutral: the model is exactly as it was).
        lower, upper: the range that is accepted and searched.
        typical: a value of the size that is met in practice; sets the scale of searches and pictures.
        text: what it is, in words.
        shape: True for a parameter that only shapes the law (a time, a Stribeck speed): it has a value, but no neutral
            one.
        along_stroke: True for a length of the piston-side chamber that is a place of the stroke: searches start it
            around where the recording begins.
        moment: True for the time of an event, counted from the start of the recording, before which the effect does
            nothing and after which it acts alike at all times: searches try it all along the recording.
        threshold: True for a value at which the effect begins: a little more of it is no more of the same term, so that
            searches start it where it stands.
    """

    name: str
    unit: str
    neutral: float
    lower: float
    upper: float
    typical: float
    text: str
    shape: bool = False
    along_stroke: bool = False
    moment: bool = False
    threshold: bool = False
