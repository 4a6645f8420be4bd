"""See why a prediction fails: when it leaves the measurement, in which channel, and what the crane does there.

python examples/debug_prediction.py RECORDING [FOLDER]     # writes channels.png, scene.png and film.gif there
"""

import sys
from pathlib import Path

import numpy as np

from crane_exudyn import Crane, Recording, simulate
from crane_exudyn.render import Scene, Trajectory
from validation import plots

recording, folder = Recording.load(sys.argv[1]), Path(sys.argv[2] if len(sys.argv) > 2 else ".")
crane = Crane.load("patu655")
model = simulate(crane, recording, step=2e-3)

noise, rms, leaves = recording.noise(), {}, {}
for name in recording.sensors:
    channel = recording[name]
    error = (channel.values - np.interp(channel.time, model.time, model[name])) / noise[name]
    rms[name] = np.sqrt(np.mean(error**2))
    leaves[name] = next(iter(channel.time[np.abs(error) > 10.0]), channel.time[-1])
    print(f"{name:6} error {rms[name]:6.1f} times the noise, beyond 10 times from {leaves[name]:.2f} s on")
worst = max(rms, key=rms.__getitem__)
when = float(leaves[worst])

measured = {name: recording[name].held(model.time) for name in recording.sensors}
lines = {"measured": measured, "simulated": {name: model[name] for name in recording.sensors}}
plots.save(plots.trajectories(model.time, lines, marks=[(when, when + 0.3, "leaves here")]), folder / "channels.png")

place = {"z1": "O", "z4": "A"}.get(worst, worst)
runs = [
    Trajectory.from_recording(recording),
    Trajectory.from_states("simulated", model.time, model.states, model.crane.layout),
]
scene = Scene(crane, runs, colour="residual", marks=[place], title=recording.name, size=(640, 360))
scene.save(folder / "scene.png", time=min(when + 1.0, scene.end))
scene.save(folder / "film.gif", fps=4.0, speed=4.0)
