"""Many seeds of the paper's experiment, all counted: how often the own tuning reaches the published errors, with
intervals that hold.

python -m validation.paper_seeds results.jsonl --seeds 100-115    a line a run, then the table; what is there is kept
python -m validation.paper_seeds results.jsonl --seeds 100-102 --nine    every error of the model with every input set
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane

from .json_lines import read_lines
from .paper import INPUT_SETS, MODEL_ERRORS, PUBLISHED, STATES, TUNINGS, run_case
from .seeds import series_parser
from .study import markdown, run

#: share of time that each state is to be inside its 95 % interval
INSIDE = 0.9
_COLUMNS = ("seed", "width", *STATES, "least inside", "NEES", "payload / kg")


def one_seed(name: str, tuning: str, inputs: int, seed: int, error: float = 0.15) -> dict[str, Any]:
    """Return the document of one run, with its name, its seed and the width of its priors."""
    case = run_case(error, inputs, "semi-recursive", seed, tuning=tuning)
    line = {"name": name, "seed": seed}
    if TUNINGS[tuning].widths:
        pump = "supply.pump_pressure"
        start = case.estimate.std[0, case.estimate.state_names.index(pump)]
        line["width"] = float(start / Crane.load("patu655").uncertainty[pump].std)
    return line | case.document()


def below(line: Mapping[str, Any]) -> bool:
    """Whether every state is at or below the published error."""
    return all(line["pn_rmse"][s] <= error for s, error in PUBLISHED.items())


def inside(line: Mapping[str, Any]) -> bool:
    """Whether every state is inside its 95 % interval for at least `INSIDE` of the time."""
    return min(line["coverage95"].values()) >= INSIDE


def table(lines: Sequence[Mapping[str, Any]]) -> str:
    """Return one row a run, and how many reach what is asked for, as Markdown."""
    count, both = len(lines), sum(below(line) and inside(line) for line in lines)
    words = (
        f"Every state at or below the published error: {sum(map(below, lines))} of {count}; all eight inside their "
        f"intervals at least {100 * INSIDE:g} % of the time: {sum(map(inside, lines))}; both: {both}."
    )
    return f"{markdown(_COLUMNS, [_row(line) for line in sorted(lines, key=lambda line: line['seed'])])}\n\n{words}\n"


def cases_table(lines: Sequence[Mapping[str, Any]]) -> str:
    """Return one row a case, over all seeds, as Markdown: of each state the share of time in % inside its interval, on
    the average (and in the worst seed), half the interval's width over the RMS error and the error in %.
    """
    cases = sorted({(line["model_error"], line["inputs"]) for line in lines}, key=lambda c: (c[1], c[0]))
    rows = []
    for error, inputs in cases:
        those = [line for line in lines if (line["model_error"], line["inputs"]) == (error, inputs)]
        cells = (_over_seeds(those, state) for state in STATES)
        rows.append([f"{100 * error:g} %", str(inputs), *cells])
    return markdown(("error", "inputs", *STATES), rows)


def _over_seeds(lines: Sequence[Mapping[str, Any]], state: str) -> str:
    inside, width, error = ([line[what][state] for line in lines] for what in ("coverage95", "width95", "pn_rmse"))
    return f"{100 * np.mean(inside):.0f} ({100 * min(inside):.0f}), {np.mean(width):.1f}, {np.mean(error):.2f}"


def _row(line: Mapping[str, Any]) -> list[str]:
    least = min(line["coverage95"], key=line["coverage95"].__getitem__)
    payload = line["found"].get("payload.mass")
    return [
        str(line["seed"]),
        f"{line['width']:.1f}" if "width" in line else "",
        *(f"{line['pn_rmse'][s]:.3f}" for s in STATES),
        f"{least} {100 * line['coverage95'][least]:.0f} %",
        f"{line['nees_mean']:.1f}",
        f"{payload['value']:.1f} ± {payload['std']:.1f}" if payload else "",
    ]


def said(line: Mapping[str, Any]) -> str:
    """Return a run in one line of text."""
    return f"{line['name']}: " + " ".join(_row(line))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run seeds of the paper's experiment on the semi-recursive engine, and show the table of them."""
    parser = series_parser("paper_seeds", main.__doc__, "100-115")
    parser.add_argument("--tuning", choices=TUNINGS, default="own")
    parser.add_argument("--inputs", type=int, choices=(1, 2, 3), default=1)
    parser.add_argument("--nine", action="store_true", help="every error with every input set, not 15 %% with one")
    given = parser.parse_args(arguments)
    names = {
        f"{given.tuning} {i} {seed}" + (f" {error:g}" if given.nine else ""): (given.tuning, i, seed, error)
        for seed in given.seeds
        for i in (INPUT_SETS if given.nine else (given.inputs,))
        for error in (MODEL_ERRORS if given.nine else (0.15,))
    }
    run(
        given.results,
        [(name, one_seed, (name, *case)) for name, case in names.items()],
        jobs=given.jobs,
        say=said,
    )
    lines = [line for line in read_lines(given.results) if line["name"] in names]
    print(cases_table(lines) if given.nine else table(lines))


if __name__ == "__main__":
    main()
