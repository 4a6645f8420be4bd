"""A leak opens in the middle of a recording: two models side by side tell when; with 100 behind it, in 100 machines."""

import sys

import numpy as np

from crane_exudyn import Crane
from crane_exudyn.inputs import SpoolPath
from crane_exudyn.measurement import Measurement
from ukf.estimator import Estimator
from ukf.side_by_side import SideBySide
from ukf.signals import Signals
from validation.semi_recursive import SemiRecursiveEngine

NOISE = {"z1": 9e-4, "z4": 9e-4, "p1": 3e4, "p4": 3e4}  # 0.05 deg, 0.3 bar
sound, leaky = Crane.load("patu655"), Crane.load("patu655").with_effect("internal_leakage@lift", {"k": 1e-11})


def recorded(opens: float, leak: float, rng: np.random.Generator, until: float = 8.0) -> Signals:
    """Return 200 samples a second of a machine whose lift cylinder leaks from `opens` (s) on."""
    time = np.arange(0.0, until, 1e-3)
    commands = 0.3 * np.sin(np.outer(time, rng.uniform(1.0, 3.0, 2)) + rng.uniform(0.0, 6.0, 2))
    inputs = np.column_stack([SpoolPath(sound).run(time, commands), np.full((time.size, 2), np.nan)])
    k, engine = int(opens / 1e-3), SemiRecursiveEngine(sound)
    before = engine.simulate(engine.static_start(0.5, -0.7), time[: k + 1], inputs[: k + 1])
    worn = SemiRecursiveEngine(sound.with_effect("internal_leakage@lift", {"k": leak}))
    states = np.vstack([before[:-1], worn.simulate(before[-1], time[k:], inputs[k:])])[::5]
    shown = Measurement.of(sound, tuple(NOISE)).shown(states, time[::5], settled=True)
    sensors = {n: (time[::5], y + rng.normal(0.0, s, y.size)) for (n, s), y in zip(NOISE.items(), shown.T, strict=True)}
    return Signals(time, commands, sensors)


waited, alarms = [], 0
for seed in range(int(sys.argv[1]) if len(sys.argv) > 1 else 1):
    rng = np.random.default_rng(seed)
    opens, leak = rng.uniform(3.0, 5.0), 1e-11 * 10.0 ** rng.uniform(-0.5, 0.5)
    models = {n: Estimator(c, "semi-recursive", NOISE, max_step=5e-3) for n, c in (("sound", sound), ("leaky", leaky))}
    found = SideBySide(models).run(recorded(opens, leak, rng))
    doubted = found.time[(found.models["leaky"] > 0.99) & (found.time > 0.5)]
    waited.append(min(doubted[doubted > opens] - opens, default=np.inf))
    alarms += bool((doubted < opens).any())
    print(f"leak of {leak:.1e} from {opens:.2f} s: found {waited[-1]:.3f} s later", flush=True)
print(f"{np.isfinite(waited).sum()} of {len(waited)} found, false alarms: {alarms}")
for late, share in zip(np.quantile(waited, [0.5, 0.95, 1.0], method="higher"), (50, 95, 100), strict=True):
    print(f"{share:5d} % of the leaks were found within {late:6.3f} s")
