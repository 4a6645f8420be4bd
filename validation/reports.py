"""The report of a comparison, a diagnosis and an improvement, all in one order.

First the verdict and what to do next; then measured and modelled over time, the place on the machine, the law with its
numbers, how sure that is; the details last. Errors are open-loop RMS in units of the sensors' noise everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from crane_exudyn.crane import Crane
from crane_exudyn.display import engineering, rounded
from crane_exudyn.effects import registry
from crane_exudyn.effects.registry import in_words
from crane_exudyn.recording import Recording

from .comparison import Comparison, from_one_start, own_parameters, with_its_own
from .comparison_figures import traces_figure
from .diagnosis import Candidate, Diagnosis, own_values, sentence
from .findings import VIOLATED, balance_words, people_unit
from .improvement import Improvement
from .learned.report import curve_parts
from .report import (
    Mood,
    Options,
    Part,
    Picture,
    Section,
    Table,
    evidence_difference,
    next_command,
    three_digits,
    write_report,
)

Parameters = Mapping[str, Mapping[str, Any]]

_MOODS: Mapping[str, Mood] = {"adequate": "good", "unknown": "bad"}
_ERRORS = "Errors are open-loop RMS over all channels in units of the sensors' noise; 1 means that only noise is left."
#: rows of the tables of what was weighed, and of where a model fails
_WEIGHED, _WORST = 12, 10


@dataclass(frozen=True)
class Examined:
    """The recordings of a result: those that were looked at, and the one that was only predicted; and what else the run
    was given that says what was looked at, by the option.
    """

    recordings: Sequence[Recording]
    check: Recording | None = None
    options: Options = field(default_factory=dict)

    def command(self, name: str) -> str:
        """Return a command to go on with, as one types it."""
        options = {"--check": _file(self.check) if self.check is not None else None, **self.options}
        # what it writes must not be the file that it reads
        crane = "newer.toml" if Path(str(options.get("--crane"))) == Path("new.toml") else "new.toml"
        return next_command(name, map(_file, self.recordings), options, ("-o", crane) if name == "improve" else ())


def _file(recording: Recording) -> str:
    return str(recording.source or recording.name)


# -- compare ---------------------------------------------------------------------------------------------------------


def report_comparison(comparisons: Sequence[Comparison], crane: Crane, examined: Examined, directory: Path) -> Path:
    """Write the report of comparisons with recordings, one after the other, and return its path."""
    mood: Mood = "good" if all(not c.where and c.error < 1.2 for c in comparisons) else "bad"
    first, names = comparisons[0], ", ".join(c.recording for c in comparisons)
    noise = ", ".join(f"{n} {e.noise_std:.3g} {e.unit}" for n, e in first.channels.items())
    parameters = {"crane": first.crane, "recording": names, "engine": first.engine, "noise of the sensors": noise}
    of = [f"{c.recording}: " if len(comparisons) > 1 else "" for c in comparisons]
    verdict = " ".join(f"{begin}{c.verdict}" for begin, c in zip(of, comparisons, strict=True))
    sections: list[Section] = [("What to do next", _after_comparisons(comparisons, examined))]
    if len(comparisons) > 1:
        sections.append(("By recording", [_by_recording([_entry(c) for c in comparisons])]))
    sections += [
        (f"{begin}{title}", parts)
        for begin, c in zip(of, comparisons, strict=True)
        for title, parts in comparison_sections(c, crane)
    ]
    return write_report(
        directory, f"{names} against {first.crane}", verdict, sections, parameters=parameters, mood=mood
    )


def _entry(c: Comparison) -> dict[str, Any]:
    """Return a comparison as an entry of `Diagnosis.recordings`; its error is what is left with what was fitted."""
    return {"recording": c.recording, "error": c.error, "parameters": c.parameters}


def comparison_sections(c: Comparison, crane: Crane) -> list[Section]:
    """Return the sections of a comparison."""
    lines = {"measured": c.measured, "simulated": c.simulated}
    found = c.figures()
    headings, by_work = balance_table(c)
    caption = f"The channels with the largest errors. {c.started}"
    simulated: list[Part] = [f"With {c.fitted}."] if c.fitted else []
    sections: list[Section] = [
        ("Measured and simulated", [*simulated, Picture(traces_figure(lines, c.layout), caption)]),
    ]
    if c.violated and not c.everywhere:
        sections.append(("Where", where_parts(crane, [c.violated[0].rpartition(".")[2]])))
    if c.where:
        table = _worst_of([(f.score, f.text) for f in c.where])
        sections.append(("Where the model fails", [Picture(found["where"], _CAPTIONS["where"]), table]))
    sections += [
        (
            "Details: open loop",
            [Table(ERROR_COLUMNS, error_rows(c), note=_ERRORS), Picture(found["open_loop"], c.started)],
        ),
        (
            "Details: what the balances lack",
            [
                Table(
                    [balance_words(h) for h in headings],
                    by_work,
                    note="± 95 %; a star marks values that are clearly not zero.",
                ),
                *(Picture(found[n], _CAPTIONS[n]) for n in ("balances_by_work", "balances")),
            ],
        ),
        ("Details: the filter", [filter_words(c), *(f"Note: {note}." for note in c.notes)]),
    ]
    return sections


def _worst_of(findings: Sequence[tuple[float, str]]) -> Table:
    """Return the table of findings (score, text), worst first, of many not all."""
    more = f" The {_WORST} worst of {len(findings)}." if len(findings) > _WORST else ""
    rows = [(f"{score:.1f}", text) for score, text in findings[:_WORST]]
    return Table(("score", "where"), rows, note=f"Scores are standard deviations.{more}")


ERROR_COLUMNS = ("channel", "unit", "RMSE", "% of range", "bias", "noise", "error / noise", "R²", "whiteness p")


def error_rows(c: Comparison) -> list[tuple[object, ...]]:
    """Return the table of channels."""
    white = c.estimate.whiteness
    return [
        (
            n,
            e.unit,
            *map(three_digits, (e.rmse, e.pn_rmse, e.bias, e.noise_std, e.error_over_noise)),
            e.r2,
            _share(white[n]) if n in white else None,
        )
        for n, e in c.channels.items()
    ]


def filter_words(c: Comparison) -> str:
    """Return what the innovations say of a filter that trusts the model."""
    low, high = c.estimate.nis_bounds
    word = "consistent with the model" if c.consistent else "NOT consistent with the model"
    return f"Filter that trusts the model: mean NIS {c.estimate.nis_mean:.3g}, expected {low:.3g} … {high:.3g}; {word}."


def balance_table(c: Comparison) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return columns and rows of what each balance lacks in each kind of work; a star marks what is clearly not
    zero.
    """
    equations = c.layout.equations
    units = [people_unit(e, c.layout) for e in equations]
    columns = ("work", *(f"{e} [{unit}]" for e, (unit, _) in zip(equations, units, strict=True)))
    rows = []
    for kind, mean, std in c.scores.by_kind():
        cells = [
            (rounded(m / factor, 1.96 * s / factor) + ("*" if abs(m) > VIOLATED * s else " "))
            if math.isfinite(s)
            else "unknown "
            for m, s, (_, factor) in zip(mean, std, units, strict=True)
        ]
        rows.append((kind, *cells))
    return columns, rows


_CAPTIONS = {
    "where": "What fails when: time from left to right, channels (filter) and balances (smoother) from top to bottom; "
    "dark is bad.",
    "balances": "Flow and moment that each balance lacks, with 95 % interval from the sensors' noise.",
    "balances_by_work": "The same, averaged over each kind of work.",
}


def _after_comparisons(comparisons: Sequence[Comparison], examined: Examined) -> list[Part]:
    if not any(c.where for c in comparisons):
        these = "this recording" if len(comparisons) == 1 else "these recordings"
        return [
            f"Nothing has to be done for {these}. A recording with other loads and speeds shows whether the model "
            "holds there."
        ]
    check = f"`{examined.command('check')}` checks the recording: signs, exchanged channels, units."
    find = (
        f"`{examined.command('diagnose')}` finds which physical effect is missing; give a second recording with "
        "`--check`."
    )
    return [check, find] if any(c.everywhere for c in comparisons) else [find]


# -- diagnose --------------------------------------------------------------------------------------------------------


def report_diagnosis(
    d: Diagnosis, directory: str | Path, given: Mapping[str, object] | None = None, examined: Examined | None = None
) -> Path:
    """Write the report of a diagnosis and return its path.

    Args:
        d: the diagnosis.
        directory: for report.html; is made if it does not exist.
        given: more parameters of the run, by name.
        examined: the recordings, for their traces.
    """
    parameters = {"crane": d.given.name, "recording": d.recording} | dict(given or {})
    mood = _MOODS.get(d.verdict, "neutral")
    sections = diagnosis_sections(d, examined)
    return write_report(
        directory, f"Diagnosis of {d.recording}", verdict(d), sections, parameters=parameters, mood=mood
    )


def verdict(d: Diagnosis) -> str:
    """Return the verdict in one or two sentences, effects named in words and by their keys."""
    if not d.effects:
        return _as_sentence(sentence(d).replace("->", "→"))
    chosen = next((c for c in d.candidates if c.effects == d.effects), None)
    named = " and ".join(_with_size(e, chosen.parameters if chosen else {}) for e in d.effects)
    keys = ", ".join(f"`{e}`" for e in d.effects)
    text = f"{named} {'is' if len(d.effects) == 1 else 'are'} missing ({keys})"
    if d.verdict == "tied":
        text += f", or {' or '.join(in_words(e) for e in d.tied_with)}: this recording cannot separate them"
    check = f", of the check recording from {d.check_error_before:.3g} to {d.check_error_after:.3g}"
    return (
        f"{text[0].upper()}{text[1:]}. The open-loop error falls from {d.error_before:.3g} to {d.error_after:.3g} "
        "times the "
        f"sensors' noise{'' if math.isnan(d.check_error_before) else check}."
    )


def _with_size(key: str, parameters: Parameters) -> str:
    """Return an effect in words with its one number, or without where it has several."""
    own = _of_effect(key, parameters)
    return in_words(key) + (f", {interval_text(*own.values())}," if len(own) == 1 else "")


def interval_text(p: Mapping[str, Any]) -> str:
    """Return a parameter with its 95 % interval in engineers' units, such as "2.40 ± 0.01 l/min at 100 bar"."""
    value, half, unit = interval(p)
    return f"{rounded(value, half) if math.isfinite(half) else f'about {value:.2g}'} {unit}".strip()


def interval(p: Mapping[str, Any]) -> tuple[float, float, str]:
    """Return a parameter's value, half its 95 % interval, and their unit as engineers read it."""
    unit, factor = engineering(p["unit"])
    return p["value"] / factor, 1.96 * p["std"] / factor, unit


def _of_effect(key: str, parameters: Parameters) -> dict[str, Mapping[str, Any]]:
    """Return the parameters of one of the effects of a candidate; several effects' names begin with their keys."""
    return {n.rpartition(":")[2]: p for n, p in parameters.items() if n.rpartition(":")[0] in ("", key)}


def diagnosis_sections(d: Diagnosis, examined: Examined | None = None) -> list[Section]:
    """Return the sections of a diagnosis."""
    chosen = next((c for c in d.candidates if c.effects == d.effects), None)
    sections: list[Section] = [("What to do next", after_diagnosis(d, examined))]
    if examined is not None and d.crane is not d.given:
        given = [d.given] * len(examined.recordings)
        sections.append(("Before and after", before_and_after(examined.recordings, given, cranes_of(d), d.recordings)))
    sections += what_is_left(d, examined)
    if d.recordings:
        sections.append(("By recording", [_by_recording(d.recordings)]))
    if d.effects:
        sections.append(("Where", where_parts(d.given, _places(d.effects))))
        sections.append(("What is missing", law_parts(d.effects, chosen.parameters if chosen else {})))
    return [*sections, ("How sure", sureness(d)), *_details(d)]


def what_is_left(d: Diagnosis, examined: Examined | None) -> list[Section]:
    """Return the sections on what no known effect explains: over time, and in which balance of the machine; none where
    something does.
    """
    sections: list[Section] = []
    if d.nearest and examined is not None:
        label = "with parameters fitted" if d.parameters else "as given"
        caption = f"Measured, and simulated from the commands alone with the crane file {label}."
        traces: list[Part] = [
            Picture(traces_figure(from_one_start(r, {label: crane}), crane.layout), f"{r.name}: {caption}")
            for r, crane in zip(examined.recordings, d.nearest, strict=True)
        ]
        sections.append(("Measured and modelled", traces))
    if not d.where:
        return sections
    violated = list(dict.fromkeys(w["equation"] for w in d.where if "equation" in w))
    parts: list[Part] = []
    if len(violated) == len(d.given.layout.equations):
        parts.append("Every balance of the model is violated, so no single place stands out.")
    elif violated:
        parts += where_parts(d.given, [violated[0].rpartition(".")[2]])
    table = _worst_of([(w["score"], w["text"]) for w in d.where])
    return [*sections, ("What remains unexplained", [*parts, table])]


def cranes_of(d: Diagnosis) -> list[Crane]:
    """Return the crane with what was found as it was in each recording: with what differs from one to another."""
    return [with_own(d.crane, entry) for entry in d.recordings] or [d.crane]


def with_own(crane: Crane, entry: Mapping[str, Any]) -> Crane:
    """Return the crane with what one of several recordings has of its own, as `Diagnosis.recordings` tells it."""
    return crane.with_parameters({n: p["value"] for n, p in entry.get("parameters", {}).items()})


def after_diagnosis(d: Diagnosis, examined: Examined | None) -> list[Part]:
    """Return what to do next, in sentences."""
    improve, learn = (
        examined.command(name) if examined is not None else f"patu {name} {d.recording}{more}"
        for name, more in (("improve", " -o new.toml"), ("learn", ""))
    )
    unchecked = "" if not math.isnan(d.check_error_before) else (
        "Give a second recording with `--check`. An effect that also predicts it is confirmed."
    )  # fmt: skip
    todo = {
        "adequate": "Nothing has to be added for this recording. A recording with other loads and speeds shows "
                    "whether the model holds there.",
        "parameters": f"`{improve}` writes the fitted parameters into a crane file. Measure those that changed "
                      "most.",
        "effect": f"`{improve}` adds the effect to the crane file and checks whether anything else is missing.",
        "tied": "To separate the explanations: "
                f"{d.next_manoeuvre or 'record other loads and speeds'}",
        "unknown": f"`{learn}` looks for a law that is not in the library; `{improve}` adds effects one after the "
                   "other if none alone explains the recording.",
    }[d.verdict]  # fmt: skip
    if d.verdict == "parameters" and not d.parameters and any(e.get("parameters") for e in d.recordings):
        todo = "Nothing has to be added to the crane file: the parameters that differ between recordings explain them."
    if examined is not None and examined.check is not None:
        everything = replace(examined, recordings=(*examined.recordings, examined.check), check=None)
        if d.misses_check:
            todo = f"`{everything.command('check')}` checks all recordings: signs, exchanged channels, units."
        elif d.left_open:
            todo = f"`{everything.command('improve')}` learns from all recordings."
    return list(filter(None, (_as_sentence(d.left_open), todo, unchecked)))


def _as_sentence(remark: str) -> str:
    return f"{remark[0].upper()}{remark[1:].rstrip('.')}." if remark else ""


def sureness(d: Diagnosis) -> list[Part]:
    """Return how the explanations were weighed against each other."""
    best = d.candidates[0].evidence if d.candidates else 0.0
    rows = [
        (in_words(c.name), evidence_difference(c.evidence, best), _share(c.probability), *c.errors_after)
        for c in d.candidates[:_WEIGHED]
    ]
    columns = ("explanation", "log evidence", "probability", "error / noise", "on check")
    note = f"Log evidence is relative to the best; 5 less is about a hundred times less likely. {_ERRORS}"
    caption = (
        "Gain in log evidence of each explanation over fitted parameters alone (the chosen one in full colour), "
        "and the error."
    )
    return [*_rivals(d), Picture(d.plot(), caption), Table(columns, rows, note=note)]


def _rivals(d: Diagnosis) -> list[str]:
    """Return what comes next after the chosen explanation, and by how much it is less likely."""
    if d.verdict == "tied":
        return [f"Equally likely: {', '.join(in_words(e) for e in d.tied_with)}."]
    chosen = next((c for c in d.candidates if c.effects == d.effects), None)
    others = [c for c in d.candidates if c is not chosen]
    if d.verdict == "unknown" or chosen is None or not others:
        return []
    behind = evidence_difference(chosen.evidence, others[0].evidence)
    return [f"The next best explanation, {in_words(others[0].name)}, is {behind:g} lower in log evidence."]


def _share(probability: float) -> str:
    return "< 0.001" if probability < 1e-3 else f"{probability:.3f}"


def _details(d: Diagnosis) -> list[Section]:
    sections: list[Section] = []
    rivals = [row for c in d.candidates[:3] if c.effects != d.effects for row in _parameter_rows(c)]
    if rivals:
        sections.append(
            (
                "Details: parameters of the other explanations",
                [Table(("parameter", "value", "unit"), rivals, note="± 95 %.")],
            )
        )
    if d.parameters:
        rows = [(n, *_beside(p), engineering(p["unit"])[0]) for n, p in d.parameters.items()]
        wide = ("parameter", "value", "nominal", "unit")
        sections.append(("Details: nominal parameters that changed", [Table(wide, rows, note="± 95 %.")]))
    if d.notes:
        sections.append(("Details: remarks", [_as_sentence(r) for r in d.notes]))
    return sections


def _beside(p: Mapping[str, Any]) -> tuple[str, float]:
    value, half, _ = interval(p)
    return rounded(value, half), p["nominal"] / engineering(p["unit"])[1]


def _parameter_rows(c: Candidate) -> list[tuple[object, ...]]:
    rows: list[tuple[object, ...]] = []
    for name, p in c.parameters.items():
        value, half, unit = interval(p)
        rows.append((f"{in_words(c.name)}: {name}", rounded(value, half), unit or "–"))
    return rows


# -- what the reports share ------------------------------------------------------------------------------------------


def before_and_after(
    recordings: Sequence[Recording],
    given: Sequence[Crane],
    improved: Sequence[Crane],
    entries: Sequence[Mapping[str, Any]] = (),
) -> list[Part]:
    """Return pictures of what was measured, and of the given and the improved model of each recording from the same
    start.

    Args:
        recordings: what was measured.
        given, improved: the model as it was in each of them.
        entries: of each, as `Diagnosis.recordings` has them, where parameters differ from one to another.
    """
    caption = (
        "Measured, and simulated from the same start and the commands alone with the crane file as given and as "
        "improved."
    )
    own = [f" ({own_values(e)})" if e.get("parameters") else "" for e in entries] or [""] * len(recordings)
    return [
        Picture(
            traces_figure(from_one_start(r, {"as given": before, "improved": after}), before.layout),
            f"{r.name}{words}: {caption}",
        )
        for r, before, after, words in zip(recordings, given, improved, own, strict=True)
    ]


def _by_recording(entries: Sequence[Mapping[str, Any]]) -> Table:
    """Return the table of entries as `Diagnosis.recordings` has them; those of other results know fewer errors."""
    columns = {"error": "error / noise", "error_before": "error before", "error_after": "after"}
    known = [key for key in columns if key in entries[0]]
    own = ["own values"] if any(e.get("parameters") for e in entries) else []
    rows = [(e["recording"], *(three_digits(e[key]) for key in known), *(own_values(e) for _ in own)) for e in entries]
    return Table(("recording", *(columns[key] for key in known), *own), rows)


def _places(keys: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(filter(None, (registry.split_key(k)[1] for k in keys))))


def where_parts(crane: Crane, places: Sequence[str]) -> list[Part]:
    """Return a sketch of the machine with places marked; a sentence where what was found acts on the whole machine."""
    if not places:
        return ["It acts on the whole machine."]
    from crane_exudyn.render_frames import overview

    return [Picture(overview(crane, places), f"The machine at its start; marked: {', '.join(places)}.")]


def law_parts(keys: Sequence[str], parameters: Parameters) -> list[Part]:
    """Return law, signature and parameters of effects in words and engineers' units."""
    parts: list[Part] = []
    for key in keys:
        effect, _ = registry.split_key(key)
        texts = {p.name: p.text for p in effect.parameters}
        rows = []
        for name, p in _of_effect(key, parameters).items():
            value, half, unit = interval(p)
            rows.append((name, texts.get(name, ""), rounded(value, half), unit or "–", p["value"], p["unit"] or "–"))
        signature = effect.signature()
        parts += [f"{in_words(key)[0].upper()}{in_words(key)[1:]}, `{key}`. Law: {effect.law()}"]
        parts += [f"Signature: {signature}"] if signature else []
        if rows:
            parts.append(Table(("parameter", "meaning", "value", "unit", "in SI", "SI unit"), rows, note="± 95 %."))
    return parts


# -- improve ---------------------------------------------------------------------------------------------------------


def report_improvement(
    result: Improvement,
    directory: str | Path,
    given: Mapping[str, object] | None = None,
    examined: Examined | None = None,
    own: Sequence[Mapping[str, Any]] = (),
) -> Path:
    """Write the report of an improvement and return its path; arguments as of `report_diagnosis`; `own` as
    `improved_own` gives it.
    """
    first = result.diagnoses[0]
    added = [e.key for e in result.crane.effects if first.given.effect(e.key) is None]
    parameters = {
        n: p for d in result.diagnoses for c in d.candidates if c.effects == d.effects for n, p in _keyed(c).items()
    }
    rows = [
        (in_words(s.added or "as given"), *map(three_digits, (s.error, s.check_error, s.nis_mean)), s.text)
        for s in result.steps
    ]
    expected = (
        "NIS is that of a filter that trusts the model, as in a comparison; it should equal the number of sensors. "
        f"{_ERRORS}"
    )
    table = Table(("step", "error / noise", "on check", "filter's NIS", "result"), rows, note=expected)
    sections: list[Section] = [("What to do next", _after_improvement(result, examined))]
    traces: list[Part] = []
    if examined is not None and len(result.steps) > 1:
        before, after = cranes_of_improvement(result, examined.recordings, own)
        traces = before_and_after(examined.recordings, before, after, own)
    falling = Picture(
        result.plot(), "Open-loop error on the Exudyn engine after each step, in units of the sensors' noise."
    )
    sections.append(("Before and after", [falling, *traces, table]))
    if own:
        sections.append(("By recording", [_by_recording(own)]))
    sections += what_is_left(first, examined) if len(result.steps) == 1 else []
    if added:
        sections.append(("Where", where_parts(first.given, _places(added))))
        named = [key for key in added if registry.split_key(key)[0].curve is None]
        if named:
            sections.append(("What was missing", law_parts(named, _complete(result.crane, named, parameters))))
    if result.learned is not None and result.learned.laws:
        sections.append(("Learned, because no named effect explains it", curve_parts(result.learned)))
    sections.append(("How sure", [verdict(first), *sureness(first)]))
    sections += _details(first)
    about = {"crane": first.given.name, "recording": result.recording} | dict(given or {})
    mood = _MOODS.get(result.verdict, "neutral")
    title = f"Improvement on {result.recording}"
    return write_report(directory, title, outcome(result), sections, parameters=about, mood=mood)


def improved_own(result: Improvement, recordings: Sequence[Recording]) -> list[dict[str, Any]]:
    """Return by recording what differs from one to another, fitted with the crane that an improvement ends with, as
    entries of `Diagnosis.recordings`; none where nothing may differ.
    """
    names = _own_names(result)
    return [
        {"recording": r.name, "parameters": own_parameters(with_its_own(result.crane, r, names), result.crane, names)}
        for r in recordings if names
    ]  # fmt: skip


def _own_names(result: Improvement) -> list[str]:
    """Return the parameters that differ from recording to recording."""
    recordings = result.diagnoses[0].recordings
    return [*recordings[0].get("parameters", {})] if recordings else []


def cranes_of_improvement(
    result: Improvement, recordings: Sequence[Recording], own: Sequence[Mapping[str, Any]] = ()
) -> tuple[list[Crane], list[Crane]]:
    """Return the crane as given and as improved as they were in each recording, as the errors of the steps take them:
    both with what is its own.
    """
    given, names = result.diagnoses[0].given, _own_names(result)
    entries = own or improved_own(result, recordings) or [{}] * len(recordings)
    return [with_its_own(given, r, names) for r in recordings], [with_own(result.crane, e) for e in entries]


def _keyed(c: Candidate) -> dict[str, Mapping[str, Any]]:
    """Return a candidate's parameters, each with its effect's key before its name."""
    return {f"{key}:{n}": p for key in c.effects for n, p in _of_effect(key, c.parameters).items()}


def _complete(crane: Crane, keys: Iterable[str], known: Parameters) -> dict[str, Mapping[str, Any]]:
    """Return the parameters of a crane's effects: as they were found, and without uncertainty where only the crane
    knows them.
    """
    from crane_exudyn.crane_toml import unit_at

    found: dict[str, Mapping[str, Any]] = {}
    for key in keys:
        (effect, place), acting = registry.split_key(key), crane.effect(key)
        assert acting is not None
        for p in effect.parameters:
            name, unit = f"{key}:{p.name}", unit_at(p.unit, place, crane.layout)
            found[name] = known.get(name, {"value": acting.parameters[p.name], "std": math.nan, "unit": unit})
    return found


def _after_improvement(result: Improvement, examined: Examined | None) -> list[Part]:
    file = "Use the new crane file with `--crane` from now on; `patu remove` undoes what was added."
    if result.verdict == "adequate":
        return [file] if len(result.steps) > 1 else ["Nothing has to be added for this recording."]
    last = result.diagnoses[-1]
    left = (
        last.next_manoeuvre
        or "Record another manoeuvre, with other loads and speeds, and improve the new crane file on it."
    )
    learn = list[Part]()
    if examined is not None and result.learned is None and not last.misses_check:
        learn.append(f"`{examined.command('learn')}` looks for a law that is not in the library.")
    return [*([file] if len(result.steps) > 1 else []), *learn, left]


def outcome(result: Improvement) -> str:
    """Return in one or two sentences what was added, what that did, and what is left."""
    first, last = result.steps[0], result.steps[-1]
    added = [in_words(s.added) for s in result.steps if s.added]
    left = "Only noise is left." if result.verdict == "adequate" else f"Left: {result.verdict}."
    if not added:
        return f"Nothing was added; the open-loop error is {first.error:.3g} times the sensors' noise. {left}"
    check = "" if math.isnan(last.check_error) else f", on the check recording to {last.check_error:.3g}"
    return (
        f"With {' and '.join(added)} the open-loop error falls from {first.error:.3g} to {last.error:.3g} times the "
        f"sensors' noise{check}. {left}"
    )
