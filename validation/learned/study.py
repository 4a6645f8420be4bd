"""The study of learning: machines with laws that are in no effect file, through `patu learn`, and how it did.

python -m validation.learned.study run results.jsonl --seeds 7000-7023     a line a case; finished ones are kept
python -m validation.learned.study tables results.jsonl                    what came out, as Markdown
"""

from __future__ import annotations

import argparse
import math
import time
import traceback
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from crane_exudyn.effects import registry

from ..hidden import HiddenCase, make_case
from ..hidden_plant import LEARNABLE
from ..json_lines import read_lines
from ..seeds import seed_range
from ..study import drawn_line, markdown, run, share
from .laws import curve_at

#: a machine without a law after each four with one: clean, and with effects of the library in turn
_WITHOUT = ({"kind": "none"}, {"kind": "effect"}, {"kind": "parameters"}, {"kind": "two"})
#: largest error of a curve, of its largest value; error on the check recording that counts as explained
_CURVE, _CHECK = 0.1, 1.3


def planned(seed: int) -> dict[str, Any]:
    """Return the arguments of `make_case` for a seed: the laws in turn, every fifth machine without one."""
    if seed % 5 == 4:
        return dict(_WITHOUT[seed // 5 % len(_WITHOUT)])
    names, turn = list(LEARNABLE), seed - seed // 5
    return {"kind": "unknown", "keys": [names[turn % len(names)]], "visible": (5.0, math.inf)}


def judge(answer: Mapping[str, Any], found: Mapping[str, Any]) -> dict[str, Any]:
    """Return how what was learned (the JSON of `patu learn`) compares with the answer of a case.

    Returns:
        "place": balance and place right; "argument": the argument too, first or tied; "curve", "departure": greatest
        error over the visited range, by the curve's greatest value and by its greatest departure from neutral there;
        "check": the check recording explained. Where no law was to be found: "silent".
    """
    truth = answer.get("law", {})
    if not truth.get("effect"):
        return {"silent": not found["laws"]}
    law = next((law for law in found["laws"] if law["effect"] == truth["effect"]), None)
    named = {f"{truth['effect']} over {truth['over']}"}
    tied = named & {t.partition(" against")[0].partition(" as")[0] for law in found["laws"] for t in law["tied_with"]}
    right = law is not None and law["over"] == truth["over"]
    curve, departure = _curve_errors(law, truth) if right and law is not None else (None, None)
    return {
        "place": law is not None or bool(tied),
        "argument": right or bool(tied),
        "curve": curve,
        "departure": departure,
        "check": found["check_error_after"] <= _CHECK,
    }


def _curve_errors(law: Mapping[str, Any], truth: Mapping[str, Any]) -> tuple[float, float]:
    x, y = np.array(truth["x"]), np.array(truth["y"])
    inside = (x >= law["x"][0]) & (x <= law["x"][-1])
    x, y = x[inside], y[inside]
    curve = registry.split_key(law["effect"])[0].curve
    assert curve is not None
    over = curve.argument(law["over"], law["effect"])
    error = np.abs(curve_at(np.array(law["x"]), np.array(law["y"]), x) - y).max()
    return float(error / np.abs(y).max()), float(error / np.abs(y - [over.neutral(v) for v in x]).max())


def run_one(case: HiddenCase, name: str) -> dict[str, Any]:
    """Return one line of results."""
    from ..learning import learn

    began = time.perf_counter()
    line: dict[str, Any] = {"name": name, "answer": case.answer}
    try:
        found = learn(case.nominal, case.learn, case.check, jobs=1).to_dict()
    except Exception as problem:  # a study must tell of a failure, not end with it
        return line | {"failed": repr(problem), "trace": traceback.format_exc(limit=-4)}
    return line | {"found": found, "judged": judge(case.answer, found), "seconds": time.perf_counter() - began}


def _seed_line(seed: int) -> dict[str, Any]:
    plan = planned(seed)
    wanted = {"kind": plan["kind"], "law": {"name": plan.get("keys", [""])[0]}}
    return drawn_line(f"case_{seed}", partial(make_case, seed, **plan), run_one, wanted)


def summary(line: Mapping[str, Any]) -> str:
    """Return a result in one line of text."""
    answer = line["answer"]
    truth = answer.get("law", {}).get("name") or answer["kind"]
    if "found" not in line:
        return f"{line['name']}: {truth}: {line.get('undrawn') or line.get('failed')}"
    f = line["found"]
    laws = ", ".join(f"{x['effect']} over {x['over']} ({x['resembles']})" for x in f["laws"]) or "no law"
    errors = " ".join(f"{f[k]:.3g}" for k in ("error_before", "error_after", "check_error_before", "check_error_after"))
    return f"{line['name']}: {truth} -> {laws}; {line['judged']}; errors {errors}; {line['seconds']:.0f} s"


def tables(lines: Sequence[Mapping[str, Any]]) -> str:
    """Return the table of a study as Markdown."""
    good = [line["judged"] for line in lines if "judged" in line]
    laws, none = [j for j in good if "place" in j], [j for j in good if "silent" in j]
    curves, departures = ([j[k] for j in laws if j[k] is not None] for k in ("curve", "departure"))
    rows = [
        ("cases", str(len(good))),
        ("failed with an error", str(sum("failed" in line for line in lines))),
        ("balance and place right", share(j["place"] for j in laws)),
        ("argument right or tied", share(j["argument"] for j in laws)),
        ("error on check after <= 1.3", share(j["check"] for j in laws)),
        ("curve within 10 % of its largest value", share(c <= _CURVE for c in curves)),
        ("curve within 10 % of its largest departure from neutral", share(c <= _CURVE for c in departures)),
        ("no law where there is none to be found", share(j["silent"] for j in none)),
    ]
    return markdown(("", ""), rows)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run cases of some seeds, or print the table of results."""
    parser = argparse.ArgumentParser(prog="python -m validation.learned.study", description=main.__doc__)
    parser.add_argument("what", choices=("run", "tables"))
    parser.add_argument("results", type=Path)
    parser.add_argument("--seeds", type=seed_range, default="7000-7011", help="FIRST-LAST (default %(default)s)")
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args(arguments)
    if given.what == "tables":
        print(tables(read_lines(given.results)))
        return
    run(given.results, [(f"case_{s}", _seed_line, (s,)) for s in given.seeds], jobs=given.jobs, say=summary)


if __name__ == "__main__":
    main()
