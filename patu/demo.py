"""`patu demo`: the main job in three acts: the filter follows a crane, a hidden effect is found and the crane file
improved, and a picture.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from textwrap import fill
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crane_exudyn.errors import CraneError

from .compiling import compiling
from .improve import tell
from .options import DEFAULT_CRANE, CraneOption, EffectsOption, EngineOption, JobsOption, JsonOption
from .output import Printer, progress
from .outputs import Writes, saving
from .reading import load_crane

if TYPE_CHECKING:
    from crane_exudyn.crane import Crane
    from crane_exudyn.recording import Recording
    from validation.comparison import Comparison
    from validation.diagnosis import Diagnosis
    from validation.improvement import Improvement, Step
    from validation.paper import Case
    from validation.report import Section

MODEL_ERROR = 0.15
COLUMNS = ("state", "this filter %", "paper's tuning %", "published %", "model alone %")
_IMPROVED = "improved.toml"
_FILES = ("filter.png", "before_after.png", "error.png", "crane.png", _IMPROVED, "report.html")


@dataclass(frozen=True)
class Found:
    """What the demo found: the paper's case by both tunings, and the recordings with the hidden effect, examined."""

    engine: str
    cases: dict[str, Case]
    recordings: tuple[Recording, Recording]
    comparison: Comparison
    improvement: Improvement
    seconds: float

    @property
    def diagnosis(self) -> Diagnosis:
        """What the model lacks."""
        return self.improvement.diagnoses[0]

    @property
    def places(self) -> list[str]:
        """The places of the effects that were found."""
        return [place for place in (key.partition("@")[2] for key in self.diagnosis.effects) if place]

    def document(self) -> dict[str, Any]:
        """Return the JSON result."""
        return {
            "cases": [case.document() for case in self.cases.values()],
            "compare": self.comparison.to_dict(),
            "diagnose": self.diagnosis.to_dict(),
            "improve": self.improvement.to_dict(_IMPROVED),
            "seconds": self.seconds,
        }


def command(
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", metavar="DIR", help="Folder for report, pictures and results; created if missing."
        ),
        Writes(files=_FILES),
    ] = Path("out/demo"),
    crane: CraneOption = DEFAULT_CRANE,
    engine: EngineOption = "exudyn",
    effects: EffectsOption = None,
    jobs: JobsOption = 2,
    seed: Annotated[int, typer.Option("--seed", help="Seed of the sensors' noise in the paper's experiment.")] = 0,
    json: JsonOption = None,
) -> None:
    """Run the main steps on the recordings that come with the package.

    First a crane runs the paper's working cycle, and a filter estimates its states; the filter's model has wrong
    masses, joints, payload and pump. Then a recording of a crane with a hidden effect is compared and diagnosed, and
    the crane file is improved; the Exudyn engine confirms the result. Finally a picture of that crane is drawn. One
    report shows all three.
    """
    printer = Printer(json)
    begin = perf_counter()
    chosen = load_crane(crane, effects)
    from validation.paper import check_machine

    check_machine(chosen)
    with compiling("check", "exudyn", "semi-recursive", "filter", "fit") as wait_for:
        wait_for("exudyn", "semi-recursive", "filter")
        printer.line(
            f"1 of 3: a crane runs the paper's 25 s working cycle ({engine} engine), and a filter estimates its states."
        )
        with progress("The paper's cycle") as done:
            cases = follow(chosen, engine, seed, done)
        printer.table("PN-RMSE: error in % of the state's range", COLUMNS, rows(cases))
        printer.line(_wrapped(followed(cases)))
    printer.line()
    printer.line(
        "2 of 3: a recording of a crane with a hidden effect is compared and diagnosed, and the crane file improved."
    )
    with progress("Comparing") as done:
        recordings, comparison = laid_beside(chosen, done)
    printer.line(_wrapped(f"Compared: {comparison.verdict}"))
    with progress("Improving") as done:
        improvement = improved(chosen, recordings, jobs, partial(tell, printer), done)
    found = Found(engine, cases, recordings, comparison, improvement, perf_counter() - begin)
    printer.line()
    printer.line("3 of 3: a picture of that crane.")
    with saving(printer) as save:
        save(output, partial(write, found, seed, printer))
        save.json(json, found.document())
    from validation.reports import verdict

    answer, _, errors = verdict(found.diagnosis).partition(". ")
    printer.line()
    printer.line(_wrapped(f"Done in {perf_counter() - begin:.0f} s. {errors}"))
    printer.line(f"Found: {answer.rstrip('.')}.")
    printer.line(f"Report: {output / 'report.html'}")


def _wrapped(text: str) -> str:
    """Return a text in lines that a terminal shows whole."""
    return fill(text, 100, break_long_words=False, break_on_hyphens=False)


def follow(crane: Crane, engine: str, seed: int, done: Callable[..., None]) -> dict[str, Case]:
    """Return the paper's case by the estimator's own tuning and by the paper's tuning, on one run of one crane."""
    from validation.paper import real_system, run_case, simulation_model, wrong_crane

    done(0.0, "the crane")
    experiment = real_system(crane, 1, engine, seed)
    alone = simulation_model(wrong_crane(crane, MODEL_ERROR), experiment, engine)
    cases = {}
    for k, (tuning, words) in enumerate((("own", "the filter"), ("paper", "the filter with the paper's tuning"))):
        cases[tuning] = run_case(
            MODEL_ERROR, 1, "semi-recursive", seed, tuning=tuning, crane=crane, experiment=experiment, open_loop=alone,
            progress=partial(_filtering, done, k, words),
        )  # fmt: skip
    return cases


def _filtering(done: Callable[..., None], case: int, words: str, share: float) -> None:
    done(0.2 + 0.4 * (case + share), words)


def rows(cases: dict[str, Case]) -> list[tuple[object, ...]]:
    """Return the table: PN-RMSE in % of each state by both tunings, as published, and by the model alone; three
    digits each.
    """
    from crane_exudyn.plots import shown
    from validation.report import three_digits

    own, paper = cases["own"], cases["paper"]
    published = own.published or {}
    return [
        (
            shown(s).symbol,
            *(three_digits(v) for v in (own.pn_rmse[s], paper.pn_rmse[s])),
            three_digits(published[s]) if s in published else None,
            three_digits(own.pn_rmse_open_loop[s]),
        )
        for s in own.pn_rmse
    ]


def followed(cases: dict[str, Case]) -> str:
    """Return in words how well the filter follows the crane."""
    own = cases["own"]
    published = own.published or {}
    better = sum(own.pn_rmse[s] <= value for s, value in published.items())
    return (
        f"The model alone is off by up to {max(own.pn_rmse_open_loop.values()):.3g} % of a state's range. This filter "
        "also estimates what may be wrong in its model (masses, joints, payload, pump). Its errors are at most "
        f"{max(own.pn_rmse.values()):.3g} %, and below the published ones in {better} of {len(published)} states. The "
        "column of the paper's tuning is for comparison."
    )


def laid_beside(crane: Crane, done: Callable[..., None]) -> tuple[tuple[Recording, Recording], Comparison]:
    """Return the recordings that come with the package, and how the model compares with the first."""
    from validation.comparison import compare
    from validation.sample import with_the_package

    recordings = with_the_package()
    return recordings, compare(crane, recordings[0], progress=done)


def improved(
    crane: Crane,
    recordings: tuple[Recording, Recording],
    jobs: int,
    told: Callable[[Step], None],
    done: Callable[..., None],
) -> Improvement:
    """Return the crane with what the first recording shows that it lacks, held against the second."""
    from validation.improvement import improve

    return improve(crane, *recordings, jobs=jobs, told=told, progress=lambda part, share: done(share, part))


def write(found: Found, seed: int, printer: Printer, folder: Path) -> list[Path]:
    """Write report, pictures, states and the improved crane file to `folder`, and return the files."""
    from validation import plots
    from validation.comparison import from_one_start
    from validation.comparison_figures import traces_figure
    from validation.paper_figures import following_figure
    from validation.report import write_report
    from validation.reports import verdict

    folder.mkdir(parents=True, exist_ok=True)
    d = found.diagnosis
    figures = {
        "filter.png": following_figure(found.cases["own"]),
        "before_after.png": traces_figure(
            from_one_start(found.recordings[0], {"as given": d.given, "improved": d.crane}), d.given.layout
        ),
        "error.png": found.improvement.plot(),
    }
    pictures = {name: folder / name for name in figures}
    for name, figure in figures.items():
        plots.save(figure, pictures[name])
    drawn = draw(found, folder / "crane.png", printer)
    found.improvement.crane.save(folder / _IMPROVED)
    written = [*pictures.values(), *drawn, folder / _IMPROVED]
    parameters = {
        "crane": found.comparison.crane,
        "engine of the crane": found.engine,
        "engine of the filter": "semi-recursive",
    }
    report = write_report(
        folder, "What crane-exudyn does", verdict(d), sections(found, pictures, drawn, written), seed=seed,
        parameters=parameters, mood="good" if d.effects else "bad",
    )  # fmt: skip
    return [*written, report]


def draw(found: Found, path: Path, printer: Printer) -> list[Path]:
    """Draw the recorded crane with an arrow at what was found; return the file, or nothing where that cannot be
    done.
    """
    from crane_exudyn.render import Scene, Trajectory

    learn, d = found.recordings[0], found.diagnosis
    try:
        scene = Scene(
            d.given, [Trajectory.from_recording(learn)], colour="pressure", marks=found.places, size=(960, 540),
            title="The recorded crane",
        )  # fmt: skip
        scene.save(path, time=3.0)
    except CraneError as problem:
        printer.line(f"No picture: {' '.join(str(problem).split())}")
        return []
    return [path]


def sections(found: Found, pictures: dict[str, Path], drawn: list[Path], written: list[Path]) -> list[Section]:
    """Return the sections of the report: three acts, and what was written."""
    from validation.report import Links, Picture, Table
    from validation.reports import law_parts, verdict, where_parts

    d, (learn, check) = found.diagnosis, found.recordings
    return [
        ("1. A filter follows a crane", [
            followed(found.cases),
            Picture(pictures["filter.png"], "The angles over the whole cycle; below, a detail of two pressures "
                                            "that are not measured."),
            Table(COLUMNS, rows(found.cases), note="PN-RMSE: 100 RMSE / (max − min of the true state)."),
            "`patu paper` shows all cases of the paper, and what limits its tuning on this crane.",
        ]),
        ("2. A hidden effect is found", [
            f"Two recordings come with the package: {learn.duration:g} s to learn from and {check.duration:g} s to "
            "check on. They are of a crane that differs from its file.",
            f"Compared with the first: {found.comparison.verdict}",
            f"Diagnosed: {verdict(d)}",
            Picture(pictures["error.png"], "Open-loop error after each step, confirmed on the Exudyn engine."),
            Picture(pictures["before_after.png"], "Measured, and simulated from the same start with the crane file "
                                                  "as given and as improved."),
            *where_parts(d.given, found.places),
            *law_parts(d.effects, next((c.parameters for c in d.candidates if c.effects == d.effects), {})),
        ]),
        ("3. A picture", [Picture(drawn[0], "The recorded crane after 3 s, coloured by pressure; the arrow marks the "
                                            "place of the effect.")]
            if drawn else ["No picture could be drawn here."]),
        ("Files", [Links(written)]),
    ]  # fmt: skip
