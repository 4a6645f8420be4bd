"""Makes the pictures of README and documentation; takes a few minutes.

python docs/make_pictures.py [FOLDER]     # default: docs/images
"""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from PIL import Image

from crane_exudyn import Crane, Recording, simulate
from crane_exudyn.render import Scene, Trajectory
from crane_exudyn.simulation import Simulation

SIZE = (960, 540)


def trajectory(label: str, run: Simulation) -> Trajectory:
    """Return a run as a trajectory of a scene."""
    return Trajectory.from_states(label, run.time, run.states, run.crane.layout)


def estimated(model: Simulation, true: Simulation) -> Trajectory:
    """Return what a filter with two angle sensors makes of a run with the wrong model."""
    from ukf.estimator import Estimator

    sensors = {"z1": 0.0175, "z4": 0.0175}
    every = slice(None, None, 10)
    random = np.random.default_rng(1)
    seen = {name: true[name][every] + random.normal(0.0, std, true.time[every].size) for name, std in sensors.items()}
    recording = Recording.from_arrays(
        "seen", true.time[every], {"u1": true["u1"][every], "u2": true["u2"][every], **seen}
    )
    estimate = Estimator(model.crane, engine="semi-recursive", sensors=sensors).run(recording)
    return Trajectory("estimated", estimate.time, estimate.mean[:, model.crane.layout.positions])


def main(folder: Path) -> None:
    """Write all pictures to a folder, which is made if it does not exist."""
    folder.mkdir(parents=True, exist_ok=True)
    crane = Crane.load("patu655")
    true = simulate(crane, step=2e-3)
    off = crane.with_parameters({"supply.pump_pressure": 80e5, "payload.mass": 120.0})
    measured, wrong = trajectory("measured", true), simulate(off, step=2e-3)
    Scene(crane, [measured], colour="pressure", title="PATU 655", size=SIZE).save(folder / "pressure.png", time=6.0)
    three = [measured, trajectory("simulated", wrong), estimated(wrong, true)]
    Scene(crane, three, marks=["lift"], title="A model with 20 bar less", size=SIZE).save(
        folder / "ghosts.png", time=14.0
    )
    demo(folder)
    tutorial(folder)


def patu(*words: str, work: str) -> None:
    """Run a command in a folder."""
    subprocess.run([sys.executable, "-m", "patu", *words], cwd=work, check=True)


def demo(folder: Path) -> None:
    """Keep the demo's picture of a model before and after it was improved."""
    with tempfile.TemporaryDirectory() as work:
        patu("demo", "-o", "demo", work=work)
        with Image.open(Path(work) / "demo" / "before_after.png") as picture:  # few colours: a quarter of the size
            picture.convert("RGB").quantize(64, dither=Image.Dither.NONE).save(folder / "demo.png", optimize=True)


def tutorial(folder: Path) -> None:
    """Run the tutorial's commands that make its pictures, and keep those."""
    text = (Path(__file__).parent / "tutorial.md").read_text(encoding="utf-8")
    commands = [shlex.split(line[2:]) for line in text.splitlines() if line.startswith("$ patu")]
    with tempfile.TemporaryDirectory() as work:
        script = Path(work) / "make_recordings.py"
        script.write_text(text.split('title="make_recordings.py"\n')[1].split("```")[0])
        subprocess.run([sys.executable, script.name], cwd=work, check=True)
        for words in commands:
            if words[1] in ("simulate", "render", "improve"):
                patu(*words[1:], work=work)
        patu("compare", "learn.csv", "-o", "pictures", work=work)
        for name in ("apart.png", "together.png"):
            shutil.copy(Path(work) / name, folder / name)
        shutil.copy(Path(work) / "pictures" / "where.png", folder / "fails.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "images")
