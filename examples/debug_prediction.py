"""See why a prediction fails: when it leaves the measurement, in which channel, and what the crane does there.

python examples/debug_prediction.py RECORDING [FOLDER]     # writes channels.png, scene.png and film.gif there
"""

import sys
from pathlib import Path

import numpy as np

from crane_exudyn import Crane, Recording, simulate
from crane_exudyn.engine import ExudynEngine
from crane_exudyn.render import Scene, Trajectory
from validation import plots
from validation.measured_start import measured_start

if len(sys.argv) < 2 or not Path(sys.argv[1]).is_file():
    sys.exit(__doc__)
recording, folder, crane = Recording.load(sys.argv[1]), Path(*sys.argv[2:3]), Crane.load("patu655")
folder.mkdir(parents=True, exist_ok=True)
engine = ExudynEngine(crane)
start = measured_start(crane, engine, recording)  # at rest where the recording begins, not where the crane file does
model = simulate(crane, recording, start=start, engine=engine, step=2e-3)

noise, rms, leaves = recording.noise(), {}, {}
for name in recording.sensors:
    channel = recording[name]
    error = (channel.values - np.interp(channel.time, model.time, model[name])) / noise[name]
    rms[name], beyond = np.sqrt(np.mean(error**2)), channel.time[np.abs(error) > 10.0]
    leaves |= {name: float(beyond[0])} if beyond.size else {}
    where = f"beyond 10 times from {leaves[name]:.2f} s on" if name in leaves else "stays within 10 times"
    print(f"{name:6} error {rms[name]:6.1f} times the noise, {where}")
worst = max(leaves or rms, key=rms.__getitem__)

measured = {name: recording[name].held(model.time) for name in recording.sensors}
lines = {"measured": measured, "simulated": {name: model[name] for name in recording.sensors}}
marks = [(leaves[worst], leaves[worst] + 0.3, "leaves here")] if leaves else []
plots.save(plots.trajectories(model.time, lines, marks=marks), folder / "channels.png")
runs = [Trajectory.from_recording(recording), Trajectory.from_states("run", model.time, model.states, crane.layout)]
place = {"z1": "O", "z4": "A"}.get(worst, worst)
scene = Scene(crane, runs, colour="residual", marks=[place], title=recording.name, size=(640, 360))
scene.save(folder / "scene.png", time=min(leaves.get(worst, scene.end) + 1.0, scene.end))
scene.save(folder / "film.gif", fps=4.0, speed=4.0)
