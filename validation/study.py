"""The study of hidden effects: many cases of `validation.hidden` through the diagnosis, and tables of how it did.

python -m validation.study run results.jsonl --seeds 5000-5119 --jobs 2   a line a case; finished ones are not run again
python -m validation.study run results.jsonl --seeds 5000-5019 --kind three              through `improve`
python -m validation.study run results.jsonl --seeds 5000-5019 --criterion helped=inf    with a rule of the search off
python -m validation.study run results.jsonl --folder DIR                 cases that `python -m validation.hidden` wrote
python -m validation.study tables results.jsonl                            what came out, as Markdown
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.machine_toml import usual_layout

from .criteria import CRITERIA, Criteria, other_criteria
from .hidden import HIDES, KINDS, SENSOR_SETS, SEVERITIES, HiddenCase, hideable, make_case
from .json_lines import add_line, read_lines
from .seeds import seed_range
from .workers import results_of, scheduled

#: kinds of ten consecutive cases of a plan
_PATTERN = ("effect", "none", "effect", "two", "effect", "parameters", "effect", "unknown", "effect", "effect")
#: visibility below which nothing is promised
PROMISED = 5.0
#: severities of the tables: visibility from … to
BINS = ((0.0, 1.0), (1.0, 2.0), (2.0, 5.0), (5.0, 15.0), (15.0, 50.0), (50.0, math.inf))
_MANY = tuple(kind for kind, n in HIDES.items() if n > 2)
_BLAMING = ("effect", "tied", "unknown")


# -- which cases -----------------------------------------------------------------------------------------------------


def planned(seed: int) -> dict[str, Any]:
    """Return the arguments of `make_case` for a seed of the study: kinds in a fixed pattern, effects in turn."""
    kind = _PATTERN[seed % len(_PATTERN)]
    if kind != "effect":
        return {"kind": kind}
    turn = sum(k == "effect" for k in _PATTERN) * (seed // len(_PATTERN)) + sum(
        k == "effect" for k in _PATTERN[: seed % len(_PATTERN)]
    )
    names = list(SEVERITIES)
    name = names[turn % len(names)]
    lay = usual_layout()
    keys = [k for k in hideable(lay.places("sensors")) if k.partition("@")[0] == name]
    key = keys[(turn // len(names)) % len(keys)]
    all_sensors = {} if key.partition("@")[2] not in set(lay.chambers) - set(lay.loaded) else {"sensors": 0}
    return {"kind": kind, "keys": [key], **all_sensors}


def folder_case(folder: Path, name: str) -> HiddenCase:
    """Return a case from files as `validation.hidden.write_cases` writes them; of its answer the verdict and, where
    there are any, the effects must be known.
    """
    from crane_exudyn.recording import Recording

    answer = json.loads((folder / "answers.json").read_text(encoding="utf-8"))[name]
    effects = answer.get("effects", [])
    kinds = {number: kind for kind, number in HIDES.items()} | {0: answer["verdict"].replace("adequate", "none")}
    answer = {"kind": kinds[len(effects)], "effects": effects, "noise": {}} | answer
    learn, check = (Recording.load(folder / f"{name}_{part}.csv") for part in ("learn", "check"))
    seed = name.rpartition("_")[2]
    return HiddenCase(int(seed) if seed.isdigit() else -1, learn, check, answer, Crane.load("patu655"))


# -- judging one -----------------------------------------------------------------------------------------------------


def judge(answer: Mapping[str, Any], found: Mapping[str, Any]) -> dict[str, Any]:
    """Return how a diagnosis (the JSON of `patu diagnose`) compares with the answer of a case.

    Returns:
        "right": verdict right, the effects first or among the tied; "first": they came first; "partly": one of several
            was named; "missed", "wrong": effects that were not named first, or without being there;
        "alarm": something was blamed though nothing was hidden; "said": the verdict, or the effects named;
        "visibility": of the least visible effect, None where nothing is hidden;
        "relative_errors": of the effects' parameters, where they came first.
    """
    truth = frozenset(answer.get("effects", ()))
    named = [frozenset(found["effects"]), *(frozenset(t.split(" + ")) for t in found["tied_with"])]
    blames = found["verdict"] in ("effect", "tied")
    first = bool(truth) and blames and named[0] == truth
    right = (blames and truth in named) if truth else found["verdict"] == answer["verdict"]
    hidden = [v for k, v in answer.get("visibility", {}).items() if k != "parameters"]
    return {
        "right": right,
        "first": first,
        "partly": blames and bool(truth) and any(n & truth for n in named),
        "missed": sorted(truth - named[0]),
        "wrong": sorted(named[0] - truth),
        "alarm": answer["verdict"] in ("adequate", "parameters") and found["verdict"] in _BLAMING,
        "visibility": min(hidden) if hidden else None,
        "said": " + ".join(found["effects"]) if blames else found["verdict"],
        "relative_errors": _relative_errors(answer, found) if first else {},
    }


def _relative_errors(answer: Mapping[str, Any], found: Mapping[str, Any]) -> dict[str, float]:
    """Return |found - true| / |true - neutral| of the effects' parameters that have a neutral value."""
    from crane_exudyn.effects import registry

    chosen = next(c for c in found["candidates"] if c["effect"] == " + ".join(found["effects"]))
    errors = {}
    for key, values in answer.get("parameters", {}).items():
        for p in registry.split_key(key)[0].parameters if "@" in key or "." not in key else ():
            given = chosen["parameters"].get(p.name) or chosen["parameters"].get(f"{key}:{p.name}")
            size = abs(values[p.name] - p.neutral) if math.isfinite(p.neutral) else abs(values[p.name])
            if given is not None and not p.shape and size > 0.0 and given["value"] is not None:
                errors[f"{key}.{p.name}"] = abs(given["value"] - values[p.name]) / size
    return errors


# -- running many ----------------------------------------------------------------------------------------------------


def run_one(case: HiddenCase, name: str, jobs: int = 1) -> dict[str, Any]:
    """Return one line of results: the answer, the diagnosis (all candidates, but no crane files) and the judgement.

    More than two effects are looked for by `improve`.
    """
    began, said = time.perf_counter(), _improved if len(case.answer["effects"]) > CRITERIA.most else _diagnosed
    line: dict[str, Any] = {"name": name, "answer": case.answer}
    try:
        found = json.loads(json.dumps(said(case, jobs)))
    except Exception as problem:  # a study of hundreds must tell of a failure, not end with it
        return line | {"failed": repr(problem), "trace": traceback.format_exc(limit=-4)}
    seconds = time.perf_counter() - began
    return line | {"diagnosis": found, "judged": judge(case.answer, found), "seconds": seconds}


def _diagnosed(case: HiddenCase, jobs: int) -> dict[str, Any]:
    from .diagnosis import diagnose

    return diagnose(case.nominal, case.learn, case.check, jobs=jobs).to_dict()


def _improved(case: HiddenCase, jobs: int) -> dict[str, Any]:
    """Return what was added, in the form of a diagnosis."""
    from .improvement import improve

    found = improve(case.nominal, case.learn, case.check, jobs=jobs)
    keys = [e.key for e in found.crane.effects]
    values = {f"{e.key}:{n}": {"value": v} for e in found.crane.effects for n, v in e.parameters.items()}
    first, last = found.steps[0], found.steps[-1]
    return {
        "verdict": "effect" if keys else found.verdict, "effects": keys, "tied_with": [],
        "candidates": [{"effect": " + ".join(keys), "parameters": values}],
        "error_before": first.error, "error_after": last.error,
        "check_error_before": first.check_error, "check_error_after": last.check_error,
    }  # fmt: skip


def drawn_line(
    name: str,
    draw: Callable[[], HiddenCase],
    examine: Callable[[HiddenCase, str], dict[str, Any]],
    wanted: Mapping[str, Any],
) -> dict[str, Any]:
    """Return the line of results of a case; where no manoeuvre shows what is `wanted` so well, that is told, and it is
    left out.
    """
    try:
        case = draw()
    except CraneError as problem:
        return {"name": name, "answer": wanted, "undrawn": str(problem)}
    return examine(case, name)


def _seed_line(seed: int, more: Mapping[str, Any], criteria: Mapping[str, float]) -> dict[str, Any]:
    plan = dict(more) if more.get("kind") else planned(seed) | dict(more)
    wanted = {"kind": plan["kind"], "verdict": "", "effects": plan.get("keys", [])}

    def examined(case: HiddenCase, name: str) -> dict[str, Any]:
        with other_criteria(**criteria):
            return run_one(case, name)

    return drawn_line(f"case_{seed}", partial(make_case, seed, **plan), examined, wanted)


def _folder_line(folder: Path, name: str) -> dict[str, Any]:
    return run_one(folder_case(folder, name), name)


def run(
    results: Path,
    tasks: Sequence[tuple[Any, ...]],
    *,
    jobs: int = 1,
    say: Callable[[Mapping[str, Any]], str] | None = None,
) -> None:
    """Run tasks (name, function, arguments) that `results` does not hold yet; a line is added as each is done, and
    said.
    """
    done = {line["name"] for line in read_lines(results)} if results.exists() else set()
    left = [(f, *a) for name, f, a in tasks if name not in done]
    for line in results_of(left, jobs, "generator_unordered"):
        add_line(results, line)
        print((say or summary)(line), file=sys.stderr, flush=True)


def summary(line: Mapping[str, Any]) -> str:
    """Return a result in one line of text."""
    answer = line["answer"]
    truth = " + ".join(answer["effects"]) or answer["verdict"]
    truth += f" ({answer['law']['name']})" if "law" in answer else ""
    if "undrawn" in line:
        return f"{line['name']}: {truth}: not drawn: {line['undrawn'][-150:]}"
    if "failed" in line:
        return f"{line['name']}: {truth}: FAILED {line['failed'][:150]}"
    j, d = line["judged"], line["diagnosis"]
    seen = ", ".join(f"{v:.3g}" for v in answer.get("visibility", {}).values())
    tied = f" ~ {', '.join(d['tied_with'])}" if d["tied_with"] else ""
    errors = " ".join(f"{d[k]:.3g}" for k in ("error_before", "error_after", "check_error_before", "check_error_after"))
    mark = "right" if j["right"] else "WRONG"
    return f"{line['name']}: {mark}: {truth} [{seen}] -> {j['said']}{tied}; errors {errors}; {line['seconds']:.0f} s"


# -- tables ----------------------------------------------------------------------------------------------------------


def tables(lines: Sequence[Mapping[str, Any]]) -> str:
    """Return the tables of a study as Markdown."""
    lines = [line for line in lines if "undrawn" not in line]
    good = [line for line in lines if "judged" in line]
    parts = [
        _summary(lines, good),
        _by_severity(good),
        _by_sensors(good),
        _by_effect(good),
        _confusion(good),
        _errors(good),
    ]
    return "\n\n".join(parts) + "\n"


def share(flags: Iterable[bool]) -> str:
    """Return how many of some flags are set, as text."""
    kept = [bool(f) for f in flags]
    return f"{sum(kept)} of {len(kept)} ({100.0 * sum(kept) / len(kept):.0f} %)" if kept else "-"


def _of(good: Sequence[Mapping[str, Any]], *kinds: str) -> list[Mapping[str, Any]]:
    return [line for line in good if line["answer"]["kind"] in kinds]


def _visible(line: Mapping[str, Any]) -> bool:
    v = line["judged"]["visibility"]
    return v is None or v >= PROMISED


def _summary(lines: Sequence[Mapping[str, Any]], good: Sequence[Mapping[str, Any]]) -> str:
    singles, clean = [g for g in _of(good, "effect") if _visible(g)], _of(good, "none", "parameters")
    after = [g["diagnosis"]["check_error_after"] for g in singles if g["judged"]["right"]]
    near = [max(g["judged"]["relative_errors"].values()) <= 0.1 for g in singles if g["judged"]["relative_errors"]]
    rows = [
        ("cases", str(len(lines))),
        ("failed with an error", str(len(lines) - len(good))),
        (
            f"one effect, visibility >= {PROMISED:g}: right (first or tied)",
            share(g["judged"]["right"] for g in singles),
        ),
        ("two effects: both right", share(g["judged"]["right"] for g in _of(good, "two"))),
        ("two effects: at least one named", share(g["judged"]["partly"] for g in _of(good, "two"))),
        ("three or four effects: all named", share(not g["judged"]["missed"] for g in _of(good, *_MANY))),
        ("three or four effects: no wrong one", share(not g["judged"]["wrong"] for g in _of(good, *_MANY))),
        ("nothing hidden: false alarms", share(g["judged"]["alarm"] for g in clean)),
        ("parameter errors only: verdict parameters", share(g["judged"]["right"] for g in _of(good, "parameters"))),
        ("law that the library lacks: unknown", share(g["judged"]["right"] for g in _of(good, "unknown"))),
        ("right ones: error on check after <= 1.2", share(a <= 1.2 for a in after)),
        ("right ones: all parameters within 10 %", share(near)),
    ]
    return markdown(("", ""), rows)


def _by_severity(good: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for low, high in BINS:
        inside = [
            g
            for g in _of(good, "effect")
            if g["judged"]["visibility"] is not None and low <= g["judged"]["visibility"] < high
        ]
        errors = [max(g["judged"]["relative_errors"].values()) for g in inside if g["judged"]["relative_errors"]]
        rows.append((
            f"{low:g} … {high:g}", share(g["judged"]["right"] for g in inside),
            share(g["judged"]["first"] for g in inside),
            _median([g["diagnosis"]["check_error_before"] for g in inside]),
            _median([g["diagnosis"]["check_error_after"] for g in inside if g["judged"]["right"]]),
            _median([100.0 * e for e in errors]),
        ))  # fmt: skip
    head = ("visibility", "right", "first", "check error before", "after (right ones)", "parameter error, %")
    return markdown(head, rows)


def _by_sensors(good: Sequence[Mapping[str, Any]]) -> str:
    """Rows are sets of sensors and their noise."""
    rows = []
    for sensors in SENSOR_SETS:
        for pressure_noise, name in ((0.3e5, "0.05° and 0.3 bar"), (1.5e5, "1° and 1.5 bar")):
            wanted = len(sensors), pressure_noise
            own = [
                g for g in good if (len(noise := g["answer"]["noise"]), noise.get(usual_layout().loaded[0])) == wanted
            ]
            hiding = [g for g in own if g["answer"]["effects"]]
            rows.append((
                " ".join(sensors), name, share(g["judged"]["right"] for g in hiding),
                share(g["judged"]["right"] for g in own if not g["answer"]["effects"]),
            ))  # fmt: skip
    return markdown(("sensors", "noise", "effects right", "right without an effect"), rows)


def _by_effect(good: Sequence[Mapping[str, Any]]) -> str:
    rows = []
    for name in sorted({g["answer"]["effects"][0].partition("@")[0] for g in _of(good, "effect")}):
        own = [g for g in _of(good, "effect") if g["answer"]["effects"][0].partition("@")[0] == name]
        wrong = Counter(g["judged"]["said"] for g in own if not g["judged"]["right"])
        seen = [g for g in own if _visible(g)]
        said = ", ".join(f"{k} ({n})" if n > 1 else k for k, n in wrong.most_common())
        rows.append((name, share(g["judged"]["right"] for g in own), share(g["judged"]["right"] for g in seen), said))
    return markdown(("effect", "right", f"right, visibility >= {PROMISED:g}", "else said"), rows)


def _confusion(good: Sequence[Mapping[str, Any]]) -> str:
    """Rows are what was hidden, columns what was said, in kinds."""
    said = ("right effect", "tied, right among them", "wrong effect", "adequate", "parameters", "unknown")
    rows = []
    for kind in KINDS:
        counts = Counter(_said(g) for g in _of(good, kind))
        rows.append((kind, *(str(counts[s]) for s in said)))
    return markdown(("hidden", *said), rows)


def _said(line: Mapping[str, Any]) -> str:
    verdict, j = line["diagnosis"]["verdict"], line["judged"]
    if verdict not in ("effect", "tied"):
        return str(verdict)
    if not line["answer"]["effects"] or not j["right"]:
        return "wrong effect"
    return "right effect" if verdict == "effect" else "tied, right among them"


def _errors(good: Sequence[Mapping[str, Any]]) -> str:
    keys = ("error_before", "error_after", "check_error_before", "check_error_after")
    rows = []
    for kind in KINDS:
        rows.append((kind, *(_median([g["diagnosis"][k] for g in _of(good, kind)]) for k in keys)))
    return markdown(("median error, noise units", "learn before", "learn after", "check before", "check after"), rows)


def _median(values: Sequence[float | None]) -> str:
    finite = [v for v in values if v is not None and math.isfinite(v)]
    return f"{np.median(finite):.3g}" if finite else "-"


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table as Markdown."""
    lines = ["| " + " | ".join(row) + " |" for row in (head, ["---"] * len(head), *rows)]
    return "\n".join(lines)


# -- command line ----------------------------------------------------------------------------------------------------


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the study of hidden effects, or show its tables."""
    parser = argparse.ArgumentParser(prog="python -m validation.study", description=main.__doc__)
    parser.add_argument("what", choices=("run", "tables"))
    parser.add_argument("results", type=Path, help="results file, a JSON a line")
    parser.add_argument("--seeds", type=seed_range, default="5000-5059", help="FIRST-LAST (default %(default)s)")
    parser.add_argument("--folder", type=Path, help="take the cases of this folder instead")
    parser.add_argument("--only", action="append", help="name of a case of the folder")
    parser.add_argument("--foreign", action="store_true", help="machines whose laws differ a little from the library's")
    parser.add_argument("--swapped", action="store_true", help="machines on the engine that the diagnosis uses")
    parser.add_argument("--smoothed", action="store_true", help="sensors whose neighbouring samples share their noise")
    parser.add_argument("--visible", metavar="LOW-HIGH", help="severities, in noise units")
    parser.add_argument("--sensors", type=int, choices=(0, 1), help=f"0: all pressures, 1: {' '.join(SENSOR_SETS[1])}")
    parser.add_argument("--noise", type=int, choices=(0, 1), help="0: 0.05 deg and 0.3 bar, 1: 1 deg and 1.5 bar")
    parser.add_argument("--kind", choices=KINDS, help="hide that in every case")
    parser.add_argument("--criterion", action="append", default=[], metavar="NAME=VALUE", help="another threshold")
    parser.add_argument("--learned", type=float, metavar="SECONDS", help="learn from so much of each recording only")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--scheduler", metavar="ADDRESS", help="Dask scheduler; local for one made here")
    given = parser.parse_args(arguments)
    if given.what == "run":
        with scheduled(given.scheduler):
            run(given.results, _tasks(given), jobs=given.jobs)
    print(tables(read_lines(given.results)))


def _tasks(given: argparse.Namespace) -> list[tuple[Any, ...]]:
    if given.folder is not None:
        names = given.only or sorted(json.loads((given.folder / "answers.json").read_text(encoding="utf-8")))
        return [(name, _folder_line, (given.folder, name)) for name in names]
    more = {n: getattr(given, n) for n in ("sensors", "noise", "kind", "learned") if getattr(given, n) is not None}
    more |= {name: True for name in ("foreign", "swapped", "smoothed") if getattr(given, name)}
    if given.visible:
        low, _, high = given.visible.partition("-")
        more["visible"] = (float(low), float(high or "inf"))
    criteria = dict(_criterion(text) for text in given.criterion)
    return [(f"case_{seed}", _seed_line, (seed, more, criteria)) for seed in given.seeds]


def _criterion(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    usual = {f.name: f.default for f in fields(Criteria)}
    if name not in usual:
        raise SystemExit(f"There is no threshold {name!r}. There are {', '.join(usual)}.")
    return name, int(value) if isinstance(usual[name], int) else float(value)


if __name__ == "__main__":
    main()
