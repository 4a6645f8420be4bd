"""Fits the effects that docs/real-crane.md names to a recording of the laboratory rig: python fit_real_crane.py REC.csv
OUT.toml [UNTIL].

The crane file that it writes begins with a legend: what was fitted, what the sources are, what each group is.

Windows of 0.25 s, then 2 s, then one open-loop run. Between the open-loop rounds each channel's noise is raised to what
the model leaves of it, so that no channel outweighs the others only because its sensor is good.
"""

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from textwrap import fill

import numpy as np
from scipy.optimize import minimize_scalar

from crane_exudyn import Crane, Recording
from crane_exudyn.geometry import pose
from validation.fit.data import FitData
from validation.fit.knots import reknot
from validation.fit.solve import Fit, fit
from validation.fit.staged import first_knots, residuals
from validation.fit.variables import EffectParameter, NominalDirection, Variable, effect_variables, uncertain_parameters
from validation.fit.windows import cut

FREE = (
    "payload.mass", "bodies.lift_boom.mass", "bodies.lift_boom.com.x", "bodies.outer_boom.mass",
    "bodies.outer_boom.com.x",
    "bodies.outer_boom.com.y", "valves.lift.flow_coefficient", "valves.lift.time_constant", "fluid.oil_bulk_modulus",
    "cylinders.lift.empty_length", "cylinders.tilt.base.x", "cylinders.tilt.empty_length",
)  # fmt: skip
#: effect -> values to start from, and which of them are fitted
EFFECTS = {
    "pressure_compensation@lift": ({"dpc": 7e5}, ()),  # only Cv sqrt(dpc) shows
    "dead_band@lift": ({"lower": 0.138, "upper": 0.175}, ("upper",)),
    "released_air": ({"alpha": 0.2, "ps": 5e5}, ("alpha",)),
    "seal_friction@lift": ({"dFc": 4000.0, "dFs": 4000.0, "vs": 3e-3}, ("dFc", "dFs")),
    "stuck_seal@tilt": ({"Fc": 4500.0, "l0": 0.0, "delta": 7e-4}, ("Fc", "l0")),
    "meter_out_restriction@lift": ({"r": 0.0}, ("r",)),
    "sensor_bias@z4": ({"b": 0.0}, ("b",)),
}
#: where the nominal parameters begin, in standard uncertainties
BEGIN = {"valves.lift.time_constant": 0.5, "valves.lift.flow_coefficient": -0.8}
#: errors of the model to begin with, SI
LEVELS = {
    "z1": 5.5e-3, "z4_abs": 3.5e-3, "p1": 3e4, "p2": 1.2e4, "p3": 1.2e4, "p4": 1.2e4, "s1": 1.2e-3, "s2": 2.5e-4,
}  # fmt: skip

LEGEND = """\
# The laboratory's PATU 655 as docs/fit_real_crane.py identified it from one lift; docs/real-crane.md has the account.
# Values are SI. It began as the built-in patu655-lab, and differs from it in what was fitted:
{fitted}
# All other numbers are those of patu655-lab at the time. [sources] gives where each comes from:
# [X]  public rigid Exudyn model of the crane (2023)
# [M]  public MATLAB semi-recursive model of the rig with its data files (2026): github.com/qkhadim22/DeepMechDyn
# [R]  what is known of the measured run: its first samples, its noise at rest
# [C]  chosen for this project, because no source gives it
#
# Masses and friction are not those of the machine: this recording cannot separate payload, boom masses and friction
# that is held at rest. Chambers: empty_length and chamber_range are as in the public models; read as a data sheet they
# would be the other way round.
"""
#: what each group of the file is, written above its heading
GROUPS = {
    "[bodies.lift_boom]": "mass in kg, centre of mass in m in the body's frame, inertia in kg m^2 about it",
    "[payload]": "fixed at the tip E of the outer boom",
    "[joints]": "pins in m, each in the frame of the body that carries it; O in that of the ground",
    "[cylinders.lift]": "pins in m, bore and rod diameter, empty length and chamber range in m; "
    "hoses in m^3, friction in N and N s/m",
    "[valves.lift]": "flow coefficient in m^3/s/sqrt(Pa), time constant of the spool in s, voltages in V",
    "[fluid]": "Pa",
    "[supply]": "Pa; overridden where the recording has pp and pt",
    "[initial]": "pose in rad, and the range in Pa of the pressure in each cylinder's less loaded chamber",
    "[sensors]": "standard deviation of each channel's noise, SI",
    "[uncertainty]": "standard uncertainty of each nominal parameter, or the range in which it lies",
    "[sources]": "where each number comes from",
    "[[effect]]": "what the recording demands beyond the public model: name, place, parameters in SI",
}


def with_effects(crane: Crane) -> Crane:
    """Return the crane with all effects at their starting values; the seal is relaxed half a millimetre from where it
    stands.
    """
    length = float(np.ravel(pose(crane, *crane.initial.pose).lengths)[1])
    relaxed = length - crane["cylinders.tilt.empty_length"] - 5e-4
    for key, (values, _) in EFFECTS.items():
        crane = crane.with_effect(key, values | ({"l0": relaxed} if key == "stuck_seal@tilt" else {}))
    return crane


def with_lever(crane: Crane, recording: Recording) -> Crane:
    """Return the crane whose rod end G of the lift cylinder is moved along the boom so that s1 answers z1 as recorded.

    Lengths and angles need no dynamics, so they are settled first; a wire sensor that shows 4 % too much would look the
    same.
    """
    time = recording["s1"].time
    z1, s1 = recording["z1"].held(time), recording["s1"].values
    name = "cylinders.lift.rod_end.x"

    def miss(x: float) -> float:
        lengths = pose(crane.with_parameters({name: x}), z1, np.full_like(z1, crane.initial.pose[1])).lengths[:, 0]
        return float(np.mean((lengths - s1) ** 2))

    best = minimize_scalar(miss, bounds=(crane[name] - 0.03, crane[name] + 0.03), method="bounded")
    return crane.with_parameters({name: float(best.x)})


def fitted(crane: Crane, data: FitData) -> Fit:
    """Return the crane fitted to the data, at last as one open-loop run."""
    nominal = [v for v in uncertain_parameters(crane) if v.name in FREE]
    acting = [
        v
        for effect in crane.effects
        if effect.key in EFFECTS
        for v in effect_variables(effect.key, effect.parameters, crane.layout)
        if v.parameter.name in EFFECTS[effect.key][1]
    ]
    variables: list[Variable] = [*nominal, *acting]
    u = np.array([*(BEGIN.get(v.name, 0.0) for v in nominal), *(v.to_u(v.start) for v in acting)])
    windows = cut(data, 0.25)
    found = fit(crane, data, windows, first_knots(crane, data), variables, u, stiffness=100.0, iterations=6)
    for seconds, stiffness, iterations in ((2.0, 100.0, 8), (60.0, 1.0, 15), (60.0, 1.0, 15)):
        windows = cut(data, seconds)
        knots = reknot(found, windows)
        found = fit(crane, data, windows, knots, variables, found.u, stiffness=stiffness, iterations=iterations)
        if seconds > 2.0:
            data = raised(data, {s.channel: s.noise * found.errors[s.channel] for s in data.samples})
    return found


def report(found: Fit) -> None:
    """Print what was fitted, with standard deviations of the linearised fit."""
    for v, x in zip(found.variables, found.u, strict=True):
        if isinstance(v, NominalDirection):
            value, scale = found.crane[v.name], v.weights[v.name]
        elif isinstance(v, EffectParameter):
            value, scale = v.to_value(float(x)), v.scale
        else:
            continue
        print(f"{v.name:40s} {value:.5g} +- {found.std(v.name) * scale:.2g}")


def raised(data: FitData, levels: dict[str, float]) -> FitData:
    """Return the data with the noise of each channel at least at a level."""
    return replace(
        data, samples=tuple(replace(s, noise=max(s.noise, levels.get(s.channel, 0.0))) for s in data.samples)
    )


def errors(crane: Crane, data: FitData, x0: np.ndarray, start: float = 0.0) -> dict[str, float]:
    """Return PN-RMSE in % of an open-loop run from x0, over the samples from `start` on, of the range of the whole
    recording.
    """
    left = residuals(crane, data, x0)
    found = {}
    for s in data.samples:
        time, r = left[s.channel]
        found[s.channel] = 100.0 * float(np.sqrt(np.mean((r[time >= start] * s.noise) ** 2)) / np.ptp(s.values))
    return found


def with_legend(text: str, fitted: Sequence[str]) -> str:
    """Return a crane file's text with its legend on top and a comment above the first heading of each group."""
    names = ["cylinders.lift.rod_end.x", *fitted, *EFFECTS]
    said = fill(", ".join(names), 120, initial_indent="#   ", subsequent_indent="#   ", break_on_hyphens=False)
    text = LEGEND.format(fitted=said) + text
    for heading, words in GROUPS.items():
        text = text.replace(f"\n{heading}\n", f"\n# {words}\n{heading}\n", 1)
    return text


def main(path: str, out: str, until: float = np.inf) -> None:
    """Fit, print and write."""
    recording = Recording.load(path)
    learn = recording.window(0.0, until)
    crane = with_effects(with_lever(Crane.load("patu655-lab"), learn))
    data = raised(FitData.of(learn, crane, step=5e-3), LEVELS)
    found = fitted(crane, data)
    report(found)
    whole = FitData.of(recording, found.crane, step=5e-3)
    print("all       ", {k: round(e, 2) for k, e in errors(found.crane, whole, found.knots[0]).items()})
    if np.isfinite(until):
        print("predicted ", {k: round(e, 2) for k, e in errors(found.crane, whole, found.knots[0], until).items()})
    found.crane.save(out)
    Path(out).write_text(with_legend(Path(out).read_text(), [v.name for v in found.variables if v.name in FREE]))
    np.savetxt(out + ".start", found.knots[0])


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], *(float(a) for a in sys.argv[3:]))
