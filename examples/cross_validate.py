"""Cross-validate models over a folder of recordings: fit on one, predict all the others, for every effect that you
suspect.

python examples/cross_validate.py FOLDER [EFFECT@PLACE …]     # writes FOLDER/cross_validation.csv
"""

import itertools
import sys
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed

from crane_exudyn import Crane, Recording
from validation.selection.fitted import fitted_effect
from validation.selection.model import open_loop_error


def error(crane: Crane, recording: Recording) -> float:
    """Return the open-loop error in noise units, the start fitted; 1 means nothing is left but noise."""
    return open_loop_error(crane, recording)[0]


def fold(effect: str | None, learn: Path, files: list[Path]) -> tuple[str, str, float, float]:
    """Return effect, recording learned from, the error there, and the mean error on all the others."""
    crane, recording = Crane.load("patu655"), Recording.load(learn)
    fitted = crane if effect is None else fitted_effect(crane, effect, recording, {})[0]
    others = [error(fitted, Recording.load(f)) for f in files if f != learn]
    return effect or "nominal model", learn.name, error(fitted, recording), float(np.mean(others))


if __name__ == "__main__":
    if len(sys.argv) < 2 or not Path(sys.argv[1]).is_dir():
        sys.exit(__doc__)
    files = sorted(f for f in Path(sys.argv[1]).glob("*.csv") if f.name != "cross_validation.csv")
    work = itertools.product([None, *sys.argv[2:]], files)
    rows = Parallel(n_jobs=2)(delayed(fold)(effect, learn, files) for effect, learn in work)
    lines = [f"{e},{n},{a:.3f},{b:.3f}" for e, n, a, b in sorted(rows, key=lambda row: row[3])]
    print(text := "\n".join(["model,learned from,error there,error on the others", *lines]))
    Path(sys.argv[1], "cross_validation.csv").write_text(text + "\n")
