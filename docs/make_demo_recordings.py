"""Makes the recordings that come with the package for `patu demo`: a crane with a leak, by usual sensors.

python docs/make_demo_recordings.py [FOLDER]     # default: validation/data
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from crane_exudyn import Crane
from crane_exudyn.formats import write_table
from crane_exudyn.units import factor_to_si
from validation.sample import Manoeuvre, recorded

#: s, and when the lift valve opens, for how long, by how much; the tilt valve does the same later
MANOEUVRES = {
    "demo_learn": Manoeuvre(8.0, ((0.8, 1.6, 0.3), (4.6, 1.2, -0.25)), later=1.9),
    "demo_check": Manoeuvre(8.0, ((0.6, 1.0, 0.35), (3.6, 1.6, -0.2)), later=1.9),
}
#: unit of each kind of channel, and digits behind the point, far finer than the sensors' noise
WRITTEN = {"": ("-", 4), "rad": ("deg", 4), "Pa": ("bar", 3)}


def main(folder: Path) -> None:
    """Write both recordings to a folder."""
    crane = Crane.load("patu655").with_effect("internal_leakage@lift", {"k": 4e-12})
    for seed, (name, manoeuvre) in enumerate(MANOEUVRES.items()):
        recording = recorded(crane, name, manoeuvre, seed)
        columns = {"time[s]": np.round(recording[recording.sensors[0]].time, 4)}
        for channel, values in recording.channels.items():
            unit, digits = WRITTEN[values.unit]
            shown = values.values / factor_to_si(unit, values.unit) if values.unit else values.values
            columns[f"{channel}[{unit}]"] = np.round(shown, digits)
        write_table(folder / f"{name}.csv.gz", columns)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent.parent / "validation" / "data")
