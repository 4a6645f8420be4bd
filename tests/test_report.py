"""Reports: verdict first, self-contained, valid, and legible where there is no colour, no network and little room."""

from __future__ import annotations

import base64
import os
import re
import shutil
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from crane_exudyn import Crane
from crane_exudyn.display import engineering
from crane_exudyn.errors import CraneError
from crane_exudyn.simulation import Simulation
from patu import calls, main
from patu.diagnose import tell
from patu.options import looked_at
from patu.output import Printer
from ukf.estimate import Estimate
from validation import improvement, plots, report, reports
from validation.comparison import ChannelError, Comparison
from validation.diagnosis import Candidate, Diagnosis
from validation.findings import Finding
from validation.improvement import Improvement, Step
from validation.reports import Examined, after_diagnosis, report_diagnosis, report_improvement

TIME = np.linspace(0.0, 25.0, 5001)


def example_figure():
    z1 = 0.3 * np.sin(0.3 * TIME)
    lines = {
        "measured": {"z1": z1 + 0.01 * np.sin(40 * TIME), "p1": 1e6 * (3 + z1)},
        "simulated": {"z1": z1 * 0.9, "p1": 1e6 * (3.1 + z1)},
        "estimated": {"z1": z1},
    }
    band = {"z1": (z1 - 0.03, z1 + 0.03)}
    return plots.trajectories(TIME, lines, bands=band, marks=[(5.0, 8.0, "lift extending")])


def example_sections():
    table = report.Table(
        ("channel", "RMSE", "consistent"), [("z1 / °", 0.123456, True), ("p1 / bar", None, False)], title="Errors"
    )
    curves = example_figure()
    return [("Angles & pressures", [curves, "The boom follows.\n\nTwice."]), ("Numbers", [table, curves])]


class Page(HTMLParser):
    """Collects tags with their attributes, and checks that what is opened is closed."""

    VOID = frozenset({"meta", "link", "img", "br", "wbr"})

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def all(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.fixture(scope="module")
def text():
    return report.render(
        "Lift <test>", "The model explains it.", example_sections(), command="patu compare 'a b.csv'", seed=7,
        mood="good",
        parameters={"payload.mass": 25.0},
    )  # fmt: skip


def test_page_is_well_formed_and_escapes_what_users_wrote(text):
    page = Page(text)
    assert page.open == []
    assert "Lift &lt;test&gt;" in text and "<test>" not in text


def test_verdict_stands_before_figures_and_tables(text):
    body = text[text.index("<body>") :]
    assert body.index("The model explains it.") < body.index("<img") < body.index("<table")


def test_nothing_is_fetched(text):
    sources = [a["src"] for a in Page(text).all("img")]
    assert len(sources) == 2 and all(s.startswith("data:image/png;base64,") for s in sources)
    assert Page(text).all("script") == []
    without_pictures = re.sub(r"data:image/png;base64,[\w+/=]+", "", text)
    assert not re.search(r"(https?:)?//\w", without_pictures)


def test_pictures_are_whole_and_said_in_words(text):
    for attributes in Page(text).all("img"):
        data = base64.b64decode(attributes["src"].partition(",")[2], validate=True)
        assert data.endswith(b"IEND\xaeB\x60\x82") and len(attributes["alt"]) > 5


def test_report_says_how_to_repeat_it(text):
    end = text[text.index("How to repeat this run") :]
    assert "patu compare &#39;a b.csv&#39;" in end and "numbers: 7" in end and "payload.mass" in end
    assert f"crane-exudyn {report.versions()['crane-exudyn']}" in end


def test_cells_read_as_people_write_them():
    values = [0.123456, -2.0, True, None, float("nan"), np.float64(3e-9), 12]
    assert [report.cell(v) for v in values] == ["0.1235", "−2", "yes", "–", "–", "3e−09", "12"]


def test_a_long_name_may_break_on_a_phone():
    html = report.table_html(("effect",), [("pressure_dependent_friction@tilt",), ("dead_band@lift",)])
    assert ">pressure_<wbr>dependent_<wbr>friction@<wbr>tilt<" in html and ">dead_band@lift<" in html


def test_table_with_a_missing_cell_is_refused():
    with pytest.raises(ValueError, match="has not 2 cells"):
        report.table_html(("a", "b"), [(1,)])


def test_file_is_replaced_whole(tmp_path):
    path = report.write_report(tmp_path / "new" / "folder", "T", "V", example_sections()[1:])
    before = path.read_bytes()
    with pytest.raises(CraneError, match="cannot be read"):
        report.write_report(path.parent, "T", "V", [("Gone", [report.Picture(tmp_path / "no.png", "nothing")])])
    assert path.read_bytes() == before and [p.name for p in path.parent.iterdir()] == ["report.html"]


def test_bytes_that_are_no_picture_are_refused():
    with pytest.raises(CraneError, match="not PNG, JPEG, GIF or SVG"):
        report.render("T", "V", [("S", [report.Picture(b"hello", "no picture")])])


def test_a_folder_that_cannot_be_made_is_told(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(CraneError, match="no folder can be created"):
        report.write_report(tmp_path / "file" / "x", "T", "V", [])


def test_lines_differ_without_colour():
    lines = example_figure().axes[0].get_lines()
    dashes = {str(line._unscaled_dash_pattern) for line in lines}  # noqa: SLF001  matplotlib tells them nowhere else
    assert len(dashes) == len(lines) == 3


def test_channels_are_drawn_in_the_units_people_use():
    axes = example_figure().axes
    assert axes[0].get_lines()[2].get_ydata()[100] == pytest.approx(np.degrees(0.3 * np.sin(0.3 * 200 * 0.005)))
    assert axes[1].get_lines()[0].get_ydata()[0] == pytest.approx(30.0)
    assert "°" in axes[0].get_ylabel() and "bar" in axes[1].get_ylabel()


def test_long_records_are_thinned_to_what_a_page_shows():
    time, values = plots.thin(np.arange(100_000.0), np.arange(100_000.0) * 2, most=4000)
    assert len(time) == 4000 and np.array_equal(values, 2 * time)


CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome") or shutil.which("chromium-browser")
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--enable-logging=stderr",
    "--v=0",
    "--hide-scrollbars",
]


def browse(page: Path, profile: Path, *more: str) -> tuple[str, str]:
    """Return what a headless browser makes of a page (DOM or nothing) and what it says."""
    run = subprocess.run(
        [str(CHROMIUM), *FLAGS, f"--user-data-dir={profile}", *more, page.as_uri()],
        capture_output=True, text=True, timeout=120, env={**os.environ, "HOME": str(profile)}, check=False,
    )  # fmt: skip
    return run.stdout, run.stderr


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine; CI installs one")
def test_browser_shows_every_picture_without_complaint(tmp_path):
    path = report.write_report(tmp_path, "T", "V", example_sections())
    probe = (
        "<script>addEventListener('load',()=>{const i=[...document.images];document.title="
        "i.length+' '+i.filter(x=>x.complete&&x.naturalWidth>500).length+' "
        "'+(document.body.scrollWidth<=innerWidth)})</script>"
    )
    path.write_text(path.read_text().replace("</body>", probe + "</body>"))
    dom, said = browse(path, tmp_path / "profile", "--window-size=390,844", "--dump-dom")
    assert "<title>2 2 true</title>" in dom
    assert "CONSOLE" not in said


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine; CI installs one")
def test_the_browser_check_notices_a_broken_page(tmp_path):
    page = tmp_path / "broken.html"
    page.write_text("<body><script>console.error('broken')</script></body>")
    assert "CONSOLE" in browse(page, tmp_path / "profile", "--dump-dom")[1]


def wide_sections():
    names = ("channel", "unit", "RMSE", "% of range", "bias", "noise", "error / noise", "R²", "whiteness p")
    wide = report.Table(names, [("p1", "bar", 0.5002, 0.8543, 0.00088, 0.4939, 1.01, 0.9988, 0.04874)])
    names = ("explanation", "log evidence", "probability", "error / noise", "on check")
    narrow = report.Table(names, [("pressure dependent friction (tilt)", -1499, "< 0.001", 0.99, 1.01)])
    return [("Tables", [wide, narrow])]


#: puts the page into a frame that is as narrow as a phone, which no window of the browser can be, and tells of each of
#: its first two tables whether it is wider than that, is said to go on, and has a shadow where it does
_NARROW = """<script>addEventListener('load', () => {
  const frame = document.createElement('iframe');
  frame.style.width = 'WIDTHpx';
  frame.srcdoc = document.documentElement.outerHTML.replace(/<script>[^]*<.script>/, '');
  frame.onload = () => {
    const of = frame.contentWindow;
    const tables = [...of.document.querySelectorAll('.scroll')].slice(0, 2);
    document.title = tables.map(t => [t.scrollWidth > t.clientWidth,
      of.getComputedStyle(t, '::after').content.includes('sideways'),
      of.getComputedStyle(t).backgroundImage.includes('gradient')].join(' ')).join(', ');
  };
  document.body.append(frame);
})</script>"""


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine; CI installs one")
def test_on_a_phone_tables_fit_or_show_that_they_go_on(tmp_path):
    path = report.write_report(tmp_path, "T", "V", wide_sections())
    page = path.read_text()
    for width, told in ((390, "true true true, false false true"), (1000, "false false true, false false true")):
        path.write_text(page.replace("</body>", _NARROW.replace("WIDTH", str(width)) + "</body>"))
        dom, _ = browse(
            path, tmp_path / "profile", "--window-size=1280,844", "--virtual-time-budget=3000", "--dump-dom"
        )
        assert f"<title>{told}</title>" in dom


# -- results show themselves, and leave as tables --------------------------------------------------------------------


def example_diagnosis():
    crane = Crane.load("patu655")
    leak = {"k": {"value": 2e-11, "std": 1e-13, "unit": "m^3/s/Pa"}}
    candidates = (
        Candidate(("internal_leakage@lift",), leak, 300.0, 1.0, crane, 22.0, 0.99),
        Candidate((), {}, 10.0, 1e-9, crane),
    )
    return Diagnosis(
        "lift, slow", "effect", crane, crane, {}, candidates, ("internal_leakage@lift",), error_before=22.0,
        error_after=0.99,
    )  # fmt: skip


def example_improvement():
    found = example_diagnosis()
    steps = (
        Step(None, 22.0, 24.0, 600.0, "effect"),
        Step("internal_leakage@lift", 0.99, 0.9, 5.8, "effect", text="a, b"),
    )
    return Improvement("lift", steps, found.crane, "adequate", (found,))


def example_comparison():
    """Two channels with clocks of their own; what the filter and the balances say is not asked for here."""
    series = {"z1": (np.array([0.0, 0.1, 0.2]), np.array([0.1, 0.2, 0.3])), "p1": (np.array([0.1]), np.array([3e6]))}
    shifted = {name: (time, values + 1.0) for name, (time, values) in series.items()}
    error = ChannelError("deg", 1.0, 1.0, 0.1, 10.0, 0.0, 0.9)
    unused = dict.fromkeys(("balances", "scores", "commands")) | {"estimate": example_estimate()}
    return Comparison(
        "lift", "patu655", "exudyn", {"z1": error, "p1": error}, where=(), measured=series, simulated=shifted, **unused
    )


def test_a_comparison_leaves_on_the_clocks_of_its_channels(tmp_path):
    example_comparison().save(tmp_path / "c.csv")
    assert (tmp_path / "c.csv").read_text().splitlines() == [
        "time[s],z1_measured[rad],z1_simulated[rad],p1_measured[Pa],p1_simulated[Pa]",
        "0.0,0.1,1.1,,", "0.1,0.2,1.2,3000000.0,3000001.0", "0.2,0.3,1.3,,",
    ]  # fmt: skip


@pytest.mark.parametrize("result", [example_diagnosis, example_improvement])
def test_results_with_texts_leave_in_every_format(result, tmp_path):
    from pyarrow import parquet
    from scipy.io import loadmat

    for name in ("r.csv", "r.parquet", "r.mat"):
        result().save(tmp_path / name)
    columns = parquet.read_table(tmp_path / "r.parquet").to_pydict()
    text, number = ("effect", "evidence") if "effect" in columns else ("added", "error")
    assert "internal_leakage@lift" in columns[text]
    assert (tmp_path / "r.csv").read_text().splitlines()[0] == ",".join(columns)
    assert loadmat(tmp_path / "r.mat")[number].ravel() == pytest.approx(columns[number])


def example_simulation():
    states = np.tile([0.1, -0.5, 0.0, 0.0, 3e6, 2e6, 2e6, 4e6], (3, 1))
    names = ("z1", "z4", "dz1", "dz4", "p1", "p2", "p3", "p4")
    inputs = np.column_stack([np.zeros((3, 2)), np.full((3, 2), np.nan)])
    return Simulation(
        Crane.load("patu655"), np.array([0.0, 0.1, 0.2]), names, states, np.zeros((3, 2)), inputs, np.zeros((3, 12))
    )


def example_estimate():
    """Three instants of one angle, and a mass that has no sensor."""
    one = np.array([[0.1], [0.2], [0.3]])
    return Estimate(
        np.array([0.0, 0.1, 0.2]), ("z1", "payload.mass"), ("z1",), np.hstack([one, 100 * one]), np.hstack([one, one]),
        one, 0.01 * one, 0.1 * one, np.zeros((3, 1), np.uint8), np.ones(3), np.ones(3), 0.0, (), np.zeros((3, 4)),
        "patu655",
        units={"z1": "rad", "payload.mass": "kg"},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("result", "told", "panels"),
    [
        (example_simulation, "lift piston side", 8), (example_estimate, "payload mass", 4),
        (example_diagnosis, "learned from", 2), (example_improvement, "as given", 1),
    ],
)  # fmt: skip
def test_results_draw_themselves(result, told, panels):
    made = result().plot()
    assert len([a for a in made.axes if a.get_visible()]) == panels
    words = [a.get_title(loc=loc) for a in made.axes for loc in ("center", "left")]
    words += [t.get_text() for a in made.axes for t in (*a.get_xticklabels(), *a.get_yticklabels())]
    assert told in words
    assert plots.png(made).startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("result", "told"),
    [
        (example_simulation, "open loop: 0.2 s at 3 "
            "instants"), (example_estimate, "payload.mass"), (example_comparison, "10 times the noise"),
        (example_diagnosis, "internal_leakage@lift"), (example_improvement, "internal_leakage@lift"),
    ],
)  # fmt: skip
def test_results_show_themselves_in_notebooks(result, told):
    html = result()._repr_html_()
    assert Page(html).open == [] and "<table" in html
    assert told in html
    assert repr(result()).startswith(f"<{type(result()).__name__} o")


def test_results_are_data_frames_in_si():
    run = example_simulation()
    frame = run.to_dataframe()
    assert (
        frame.index.name == "time" and frame["p1"].tolist() == run["p1"].tolist() and frame.attrs["units"]["p1"] == "Pa"
    )
    assert run.recording().to_dataframe()["z1"].tolist() == pytest.approx(frame["z1"].tolist())
    assert example_estimate().to_dataframe().columns.tolist() == ["z1", "payload.mass", "z1_std", "payload.mass_std"]


def test_notebooks_show_figures_and_degrees():
    recording = example_simulation().recording()
    assert recording.plot()._repr_png_().startswith(b"\x89PNG")
    assert ">bar</td>" in recording._repr_html_() and ">Pa</td>" not in recording._repr_html_()
    assert len(repr(recording["z1"])) < 80


def test_a_diagnosis_is_told_and_drawn_in_words(tmp_path):
    text = report_diagnosis(example_diagnosis(), tmp_path, {"check": None}).read_text()
    found = "Internal leakage (lift), 12.00 ± 0.12 l/min at 100 bar, is missing (<code>internal_leakage@lift</code>)."
    assert f"{found} The open-loop error falls from 22 to 0.99 times the sensors' noise" in text
    assert "Law: Leakage flow k (pa - pb) from the piston side (pressure pa) to the rod side" in text
    assert "Signature: with its valve closed, a loaded cylinder creeps" in text
    order = ["What to do next", "<h2>Where", "<h2>What is missing", "<h2>How sure"]
    assert [text.index(part) for part in order] == sorted(text.index(part) for part in order)
    assert "marked: lift" in text
    labels = [label.get_text() for label in example_diagnosis().plot().axes[0].get_yticklabels()]
    assert labels == ["internal leakage (lift)", "parameters"]


def test_a_start_away_from_what_was_measured_is_told():
    off = example_comparison()
    assert off.started.startswith("The run starts away from the measured values: z1 57 deg above; the start")  # 1 rad
    near = replace(off, simulated=off.measured)
    assert near.started.startswith("The run starts at the measured values;")


def test_where_everything_is_violated_no_single_place_is_named():
    def places(names):
        return [Finding("equation", n, 0.0, 1.0, "rest", 9.0, f"while at rest, {n} is off") for n in names]

    equations = example_comparison().layout.equations
    some, all_of_them = (replace(example_comparison(), where=places(n)) for n in (equations[:1], equations))
    assert some.verdict.endswith(f"While at rest, {equations[0]} is off.")
    assert "Every balance of the model is violated" in all_of_them.verdict and "is off" not in all_of_them.verdict


def test_units_are_those_in_which_engineers_think():
    unit, factor = engineering("m^3/s/Pa")
    assert (unit, 2e-11 / factor) == ("l/min at 100 bar", pytest.approx(12.0))
    unit, factor = engineering("N*m*s")
    assert (unit, 573.0 / factor) == ("N m at 10 deg/s", pytest.approx(100.0, rel=1e-3))
    assert engineering("kg") == ("kg", 1.0)


def test_an_improvement_says_what_it_did(tmp_path):
    text = report_improvement(example_improvement(), tmp_path).read_text()
    assert "With internal leakage (lift) the open-loop error falls from 22 to 0.99 times" in text
    assert "<h2>How sure</h2>" in text
    assert [line.get_label() for line in example_improvement().plot().axes[0].get_lines()[:2]] == [
        "learned from",
        "only predicted",
    ]


def test_a_number_reads_the_same_wherever_it_stands(tmp_path, capsys):
    d = example_diagnosis()
    found, rival = d.candidates
    found = replace(found, evidence=1508.53, error_after=0.98992, check_error_after=1.01234)
    rival = replace(rival, error_after=2.34567)
    d = replace(
        d, candidates=(found, rival), error_after=0.98992, check_error_before=3.5912, check_error_after=1.01234,
        recordings=({"recording": "lift", "error_before": 21.987, "error_after": 0.98992},),
    )  # fmt: skip
    page = re.sub(r"data:image/[^\"]*", "", report_diagnosis(d, tmp_path).read_text())
    tell(Printer(), d)
    printed = capsys.readouterr().out
    assert "is 1499 lower in" in page and ">−1499<" in page and "-1499 " in printed
    assert [t.get_text() for t in d.plot().axes[0].texts] == ["1499", "0"]
    for text in (page, printed, d._repr_html_()):
        assert "0.99" in text and "1.01" in text
        assert not [n for n in ("0.9899", "1.012", "2.346", "21.99", "1498") if n in text]


def test_what_to_do_next_carries_what_the_run_was_given(tmp_path):
    recordings = [replace(example_simulation().recording(), source=Path(f"two runs/{k}.csv")) for k in "ab"]
    options = looked_at(
        "my.toml", [Path("own.py")], ["z1=-z1[deg]"], Path("map.toml"), check=Path("c.csv"),
        per_recording=["payload.mass"], anyway=True,
    )  # fmt: skip
    machine = "--map-file map.toml --map 'z1=-z1[deg]' --crane my.toml --effects own.py"
    examined = Examined(recordings, options=options)
    expected = f"'two runs/a.csv' 'two runs/b.csv' --check c.csv --per-recording payload.mass {machine} --anyway"
    d = example_diagnosis()
    (todo, *_) = after_diagnosis(d, examined)
    assert todo.startswith(f"`patu improve {expected} -o new.toml` ")
    (todo, *_) = after_diagnosis(replace(d, verdict="unknown"), examined)
    assert todo.startswith(f"`patu learn {expected}` ") and f"`patu improve {expected} -o new.toml` " in todo
    other = replace(examined, options=looked_at("new.toml"))
    assert other.command("improve").endswith("--crane new.toml -o newer.toml")
    missed = replace(d, verdict="unknown", misses_check=True)
    with_check = replace(examined, check=replace(recordings[0], source=Path("c.csv")))
    (todo, *_) = after_diagnosis(missed, with_check)
    assert todo.startswith(f"`patu check 'two runs/a.csv' 'two runs/b.csv' c.csv {machine}` ")


def test_where_only_what_differs_moved_nothing_is_to_be_written():
    load = {"payload.mass": {"value": 80.0, "nominal": 25.0, "unit": "kg"}}
    entry = {"recording": "lift", "error_before": 8.0, "error_after": 1.0, "parameters": load}
    d = replace(example_diagnosis(), verdict="parameters", effects=(), recordings=(entry, entry))
    assert after_diagnosis(d, None)[0].startswith("Nothing has to be added to the crane file: the parameters that")
    moved = replace(d, parameters={"gravity": {"value": 9.9, "std": 0.1, "nominal": 9.81, "unit": "m/s^2"}})
    assert "writes the fitted parameters" in after_diagnosis(moved, None)[0]


@pytest.mark.parametrize("name", list(report.TAKEN))
def test_a_command_is_told_with_all_options_that_it_takes(name):
    flags = {option.flag for option in calls.options_of(main.load(name)).values()}
    assert set(report.TAKEN[name]) == flags & set(looked_at("patu655"))


def test_the_report_of_an_improvement_says_how_many_effects_it_might_add(patu, tmp_path, monkeypatch):
    file = tmp_path / "l.csv"
    file.write_text("time[s],u1,u2,z1[deg],z4[deg]\n" + "".join(f"{0.01 * k:.2f},0,0,10,-40\n" for k in range(21)))
    given = {}
    monkeypatch.setattr(improvement, "improve", lambda *_, **options: given.update(options) or example_improvement())
    monkeypatch.setattr(reports, "before_and_after", lambda *_: [])  # of a crane that stands still nothing can be drawn
    words = ("-o", str(tmp_path / "new.toml"), "--most", "3", "--report", str(tmp_path / "r"))
    done = patu("improve", str(file), *words)
    assert done.status == 0, done.err
    assert given["most"] == 3
    assert "<td>most effects</td><td>3</td>" in (tmp_path / "r" / "report.html").read_text()
