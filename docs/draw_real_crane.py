"""Draws a recording over models of it, open loop: python draw_real_crane.py REC.csv OUT.png "identified=CRANE.toml"
"published=MODEL.csv" …

A crane file runs from a fitted start, a recording of another program's model is drawn as it is.
"""

import sys

import numpy as np

from crane_exudyn import Crane, Recording
from validation import plots
from validation.fit.data import FitData
from validation.fit.staged import residuals, run_fitted

CHANNELS = ("z1", "s1", "p1", "p2", "p3", "p4")
#: share of the measured range that a panel shows above and below it; a model that is further off leaves the panel
ROOM = 0.35
Line = tuple[np.ndarray, np.ndarray]
NOTHING: Line = (np.zeros(1), np.full(1, np.nan))


def run(crane: Crane, recording: Recording) -> dict[str, Line]:
    """Return (time, values) by channel of an open-loop run whose first state is fitted."""
    data = FitData.of(recording, crane, step=5e-3)
    fit = run_fitted(crane, data)
    left = residuals(crane, data, fit.starts, fit.late)
    return {s.channel: (left[s.channel][0], s.values - left[s.channel][1] * s.noise) for s in data.samples}


def of_recording(recording: Recording) -> dict[str, Line]:
    """Return (time, values) by channel."""
    return {c: (recording[c].time, recording[c].values) for c in CHANNELS if recording.has(c)}


def main(path: str, out: str, *models: str) -> None:
    """Draw the picture."""
    recording = Recording.load(path)
    lines = {"measured": of_recording(recording)}
    for label, _, file in (m.partition("=") for m in models):
        is_crane = not file.endswith(".csv")
        lines[label] = run(Crane.load(file), recording) if is_crane else of_recording(Recording.load(file))
    made = plots.figure(len(CHANNELS), height=1.35)
    for axes, channel in zip(made.axes, CHANNELS, strict=True):
        parts = {label: named.get(channel, NOTHING) for label, named in lines.items()}  # the same look in every panel
        plots.draw_lines(axes, parts["measured"][0], parts, channel=channel)
        factor, values = plots.shown(channel).factor, parts["measured"][1]
        room = ROOM * np.ptp(values)
        axes.set_ylim(factor * (values.min() - room), factor * (values.max() + room))
    made.axes[-1].set_xlabel("time / s")
    plots.legend_above(made)
    plots.save(made, out)


if __name__ == "__main__":
    main(*sys.argv[1:])
