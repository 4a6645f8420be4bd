"""`patu estimate`: the filter over a recording."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crane_exudyn.errors import CraneError

from .compiling import Part
from .options import (
    DEFAULT_CRANE,
    AnywayOption,
    CraneOption,
    EffectsOption,
    EngineOption,
    JsonOption,
    MapFileOption,
    MapOption,
    MethodOption,
    OutputOption,
    PlotOption,
    RecordingArgument,
    ReportOption,
    StepOption,
)
from .output import Printer, progress
from .outputs import Reads, saving
from .reading import load_checked, load_crane

if TYPE_CHECKING:
    from crane_exudyn.crane import Crane
    from crane_exudyn.recording import Recording
    from ukf.estimate import Consistency, Estimate
    from ukf.estimator import Estimator
    from ukf.noise import ProcessNoise


SensorsOption = Annotated[
    list[str] | None, typer.Option("--sensors", "--sensor", metavar="CHANNEL …", help="Use only these sensors.")
]
AugmentOption = Annotated[
    list[str] | None,
    typer.Option("--augment", metavar="NAME", help="Also estimate this, such as payload.mass; repeatable."),
]
SmoothOption = Annotated[bool, typer.Option("--smooth", help="Also run a backward smoother over the recording (RTS).")]
TuneOption = Annotated[
    bool, typer.Option("--tune", help="First find the most likely process noise, not only its scale.")
]
ModelErrorOption = Annotated[
    str,
    typer.Option(
        "--model-error",
        metavar="auto|off|on",
        help="Widen the intervals for an error of the model; auto: only if needed.",
    ),
]
ModelsOption = Annotated[
    list[str] | None,
    typer.Option(
        "--models",
        metavar="A.toml B.toml …",
        help="Run these cranes side by side instead of --crane, and show which is likeliest when.",
    ),
    Reads(),
]


def command(
    recording: RecordingArgument,
    output: OutputOption = None,
    plot: PlotOption = None,
    report: ReportOption = None,
    engine: EngineOption = "exudyn",
    sensors: SensorsOption = None,
    augment: AugmentOption = None,
    method: MethodOption = "ukf",
    smooth: SmoothOption = False,
    tune: TuneOption = False,
    model_error: ModelErrorOption = "auto",
    models: ModelsOption = None,
    step: StepOption = 1e-3,
    crane: CraneOption = DEFAULT_CRANE,
    effects: EffectsOption = None,
    mapping: MapOption = None,
    map_file: MapFileOption = None,
    anyway: AnywayOption = False,
    json: JsonOption = None,
) -> None:
    """Estimate the whole state of the crane from a recording: states with 95 % intervals, innovations, consistency.

    The filter starts from the pose, rates and pressures of the first samples and uses every sensor in the recording.
    The sensors' noise comes from the crane file, or else from the recording. Anything unusual in the recording is
    reported. The exit status is 1 if the filter failed too often for a usable estimate.
    """
    cranes = model_cranes(models, crane, effects)  # with the user's own effects, before anything is compiled
    _refuse(cranes, method, augment or [], model_error, smooth and bool(models))
    chosen = next(iter(cranes.values()))
    needs: tuple[Part, ...] = (engine, "semi-recursive", "filter")
    measured = load_checked([recording], chosen, mapping, map_file, anyway=anyway, needs=needs)[0].require(sensors=1)
    std = sensor_noise(chosen, measured, sensors)
    filters = _filters(cranes, engine, std, method, augment or [], step, bool(models))
    noise = _tuned(cranes.values(), measured, std, augment or [], step, json, tune)
    from ukf.consistency import noise_slack

    slack = noise_slack(chosen, measured, std)
    filters = {name: f.varied(noise=noise) for name, f in filters.items()}
    from ukf.model_error import estimate, estimate_side_by_side

    shared: dict[str, Any] = {"mode": model_error, "noise_slack": slack, "stage": progress}
    if models:
        result = estimate_side_by_side(filters, measured, **shared)
    else:
        result = estimate(filters[crane], measured, smooth=smooth, **shared)
    printer = Printer(json)
    tell(printer, result, measured)
    with saving(printer) as save:
        save(output, _best(result).save)
        used = {"recording": str(recording), "engine": engine, "process_noise": vars(noise)}
        save.json(json, result.document() | used)
        save(plot, partial(_draw, result))
        save(report, lambda path: save_report(result, measured.name, path, engine, std))
    if result.failed:
        raise typer.Exit(1)


def _refuse(
    cranes: Mapping[str, Crane], method: str, augment: list[str], model_error: str, smoothed_together: bool
) -> None:
    """Refuse options that cannot be, before any work begins."""
    import numpy as np

    from ukf.augment import resolve
    from ukf.methods import method_of
    from ukf.model_error import mode_of

    mode_of(model_error)
    method_of(method, np.ones(1))
    for crane in cranes.values():
        resolve(crane, augment)
    if smoothed_together:
        raise CraneError(
            "--smooth and --models exclude each other: several models cannot be smoothed together. Leave one out."
        )


def _best(result: Estimate) -> Estimate:
    """Return the smoothed estimate where there is one."""
    return result.smoothed if result.smoothed is not None else result


def _draw(result: Estimate, path: Path) -> None:
    from crane_exudyn.plots import save

    save(_best(result).plot(), path)


def model_cranes(models: list[str] | None, crane: str, effects: list[Path] | None) -> dict[str, Crane]:
    """Return the crane files to run, by their names."""
    if not models:
        return {crane: load_crane(crane, effects)}
    if crane != DEFAULT_CRANE:
        raise CraneError(f"--crane {crane} and --models exclude each other. Give {crane} as one of the models.")
    short = [Path(m).stem if m.endswith(".toml") else m for m in models]
    names = short if len(set(short)) == len(models) else models
    if len(set(names)) < len(models):
        raise CraneError(f"--models names {next(m for m in models if models.count(m) > 1)} twice. Give it once.")
    cranes = {name: load_crane(m, effects) for name, m in zip(names, models, strict=True)}
    from ukf.side_by_side import check_same_machine

    check_same_machine(cranes)
    return cranes


def _filters(
    cranes: dict[str, Crane],
    engine: str,
    std: dict[str, float],
    method: str,
    augment: list[str],
    step: float,
    together: bool,
) -> dict[str, Estimator]:
    """Return a filter for each model with the default noise; what cannot run is refused here, before the search for a
    noise.
    """
    from ukf.estimator import Estimator
    from ukf.side_by_side import SideBySide

    filters = {n: Estimator(c, engine, std, None, method, augment, max_step=step) for n, c in cranes.items()}
    if together:
        SideBySide(filters)
    return filters


def sensor_noise(crane: Crane, recording: Recording, only: list[str] | None) -> dict[str, float]:
    """Return {channel: standard deviation} of the chosen sensors: the crane file's, else what the recording shows."""
    for name in only or ():
        if name not in recording.sensors:
            raise CraneError(
                f"--sensors {name}: {recording.name} has no such sensor, only {', '.join(recording.sensors)}."
            )
    measured = recording.noise()
    chosen = [n for n in recording.sensors if not only or n in only]
    # a simulated recording has no noise; a filter that believes in none cannot be corrected
    return {n: crane.sensors.get(n, max(measured[n], 0.02 * crane.layout.sensors[n].sizes.noise)) for n in chosen}


def _tuned(
    cranes: Iterable[Crane],
    recording: Recording,
    std: dict[str, float],
    augment: list[str],
    step: float,
    json: str | None,
    thorough: bool,
) -> ProcessNoise:
    """Return the most likely process noise of the models; wrong ones need more of it than right ones."""
    from ukf.tuning import scale, tune

    with progress("Noise") as done:
        found = (tune if thorough else scale)(
            tuple(cranes), recording, std, augment=tuple(augment), max_step=step, progress=done
        )
    if found.after > found.before:
        Printer(json).line(repr(found).strip("<>"))
    return found.noise


def save_report(result: Estimate, name: str, directory: Path, engine: str, std: dict[str, float]) -> Path:
    """Write the report of an estimate, verdict first, and return its file; std: the sensors' noise in SI."""
    from crane_exudyn.plots import shown
    from validation.report import Picture, Table, write_report

    best = _best(result)
    pictures = best.figures()
    states = Picture(pictures["states"], "Every quantity with its 95 % interval, and the measured values.")
    words = (
        "Innovations over their expected standard deviation; 95 % should lie in the band, without a pattern in time."
    )
    sections: list[tuple[str, list[Any]]] = [
        ("States", [states, Table(COLUMNS, rows(best))]),
        *([("Models", [Table(MODEL_COLUMNS, model_rows(result))])] if result.models else []),
        ("Consistency", [consistency(result), *allowance(result), Picture(pictures["innovations"], words)]),
        ("Events", event_lines(result) or ["Nothing unusual."]),
    ]
    parameters: dict[str, object] = {
        "crane": result.crane,
        "recording": name,
        "engine": engine,
        "filter": result.method,
    }
    for channel, value in std.items():
        _, _, factor, unit = shown(channel, "", result.layout)
        parameters[f"noise of {channel} / {unit}"] = factor * value
    mood: Any = "good" if result.consistent else "bad"
    return write_report(directory, f"Estimate of {name}", verdict(result), sections, parameters=parameters, mood=mood)


#: so many unknowns of a wrong model are named
_LISTED = 4
MODEL_COLUMNS = ("model", "probability", "at the end", "likeliest / s")
COLUMNS = ("quantity", "first", "last", "± (95 %)", "min", "max")


def rows(estimate: Estimate) -> list[tuple[object, ...]]:
    """Return the table: each quantity in units for people, at the start, at the end with its interval, and its
    range.
    """
    return [(f"{name} / {unit}" if unit else name, *numbers) for name, unit, *numbers in estimate.ranges()]


#: so many spans in which a model was the likeliest are told, s that they last at least
_SPANS, _SHORT = 3, 0.5


def model_rows(estimate: Estimate) -> list[tuple[object, ...]]:
    """Return one row a model: its probability on the average and at the end, and when it was the likeliest for long."""
    found: list[tuple[object, ...]] = []
    for name, model in estimate.document()["models"].items():
        spans = sorted((s for s in model["leads"] if s[1] - s[0] > _SHORT), key=lambda s: s[0] - s[1])[:_SPANS]
        words = ", ".join(f"{a:.2f} to {b:.2f}" for a, b in sorted(spans))
        found.append((name, round(model["mean"], 3), round(model["final"], 3), words or "never for long"))
    return found


def tell(printer: Printer, result: Estimate, recording: Any) -> None:
    """Print the final state with its interval, the consistency, and what happened."""
    printer.line(
        f"{result.crane}, {result.method}, {recording.name}: {result.time.size} instants, "
        f"{result.time[0]:g} to {result.time[-1]:g} s, sensors {', '.join(result.channel_names)}"
    )
    printer.table("", COLUMNS, rows(_best(result)))
    if result.models:
        printer.table("", MODEL_COLUMNS, model_rows(result))
    for line in (consistency(result), verdict(result), *allowance(result), *event_lines(result)):
        printer.line(line)


def event_lines(result: Estimate) -> list[str]:
    """Return one line for everything odd that happened."""
    lines = []
    for event in result.events:
        if event.start != event.start:  # of the whole recording
            lines.append(f"note: {event.text}")
            continue
        span = f"{event.start:.3f} s" if event.end == event.start else f"{event.start:.3f} to {event.end:.3f} s"
        often = f" ({event.count} times)" if event.count > 1 else ""
        lines.append(f"note: {span}: {event.where}: {event.text}{often}")
    return lines


def consistency(result: Estimate) -> str:
    """Return NIS and whiteness in one line."""
    low, high = result.nis_bounds
    white = ", ".join(f"{n} {p:.2g}" for n, p in result.whiteness.items())
    return f"NIS {result.nis_mean:.4g} (expected {low:.3g} to {high:.3g}); whiteness p: {white}"


def allowance(result: Estimate) -> list[str]:
    """Return what the intervals allow for in a model that is wrong, those unknowns first that are furthest from what
    the file says.
    """
    from crane_exudyn.plots import shown

    account = result.model_error
    if account is None or not account.used:
        return []
    if not account.found:
        return ["The intervals allow for errors of the models."]
    listed = sorted(
        account.found.items(), key=lambda item: -abs(item[1]["value"] - item[1]["nominal"]) / item[1]["std"]
    )
    words = []
    for name, now in listed[:_LISTED]:
        _, _, factor, unit = shown(name, now["unit"], result.layout)
        words.append(f"{name} {factor * now['value']:.3g} ± {factor * 1.96 * now['std']:.2g} {unit}".rstrip())
    return [
        f"The intervals allow for an error of the model with {len(listed)} unknowns. The largest at the end: "
        f"{', '.join(words)}."
    ]


_REMEDY = "`patu compare` shows where it fails; --augment estimates an unknown parameter."
#: what to make of each judgement of the consistency
VERDICTS: dict[Consistency, str] = {
    "unjudged": "The consistency cannot be judged: {}. The intervals are not confirmed.",
    "noise-free": "The recording has no noise, like that of a simulation. The model explains it to less than the noise "
    "that the filter assumes for the sensors, so its intervals are on the safe side.",
    "consistent": "The filter is consistent with the recording: its intervals can be trusted.",
    "too narrow": "Not consistent: the innovations are larger than the filter expects, so the intervals are too "
    f"narrow. {_REMEDY} --tune finds a noise that fits.",
    "allowed for": "The model lacks something. Possible causes were estimated too, and the intervals allow for them. "
    + _REMEDY,
    "lacking": "Not consistent: the innovations of {} keep their sign for longer than noise does, so the model lacks "
    "something. The intervals of unmeasured quantities are too narrow, and those of the angles may be. " + _REMEDY,
    "overstated": "Not consistent: the filter takes {} to be more than twice as noisy as the recording shows, so the "
    "intervals are wider than necessary. Correct [sensors] in the crane file.",
    "too wide": "Not consistent: the filter expects more noise than there is, so the intervals are wider than "
    "necessary; try --tune.",
}


def verdict(result: Estimate) -> str:
    """Return what to make of the consistency, in plain words."""
    about = {"unjudged": result.unjudged, "overstated": result.overstated, "lacking": result.persistent}
    named = about.get(result.judgement, "")
    return VERDICTS[result.judgement].format(named if isinstance(named, str) else ", ".join(named))
