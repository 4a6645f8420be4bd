"""Reports: verdict first, self-contained, valid, and legible where there is no colour, no network and little room."""

from __future__ import annotations

import base64
import os
import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from crane_exudyn.errors import CraneError
from validation import plots, report

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
    bars = plots.bars(["z1", "p1"], {"open loop": [3.0, 8.0], "filtered": [1.0, 1.1]}, axis="error over noise")
    return [("Angles & pressures", [example_figure(), "The boom follows.\n\nTwice."]), ("Numbers", [table, bars])]


class Page(HTMLParser):
    """Collects tags with their attributes, and checks that what is opened is closed."""

    VOID = frozenset({"meta", "link", "img", "br"})

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
        "Lift <test>", "The model explains it.", example_sections(), command="patu compare 'a b.csv'", seed=7, mood="good",
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
    end = text[text.index("To repeat it") :]
    assert "patu compare &#39;a b.csv&#39;" in end and "numbers: 7" in end and "payload.mass" in end
    assert f"crane-exudyn {report.versions()['crane-exudyn']}" in end


def test_cells_read_as_people_write_them():
    values = [0.123456, -2.0, True, None, float("nan"), np.float64(3e-9), 12]
    assert [report.cell(v) for v in values] == ["0.1235", "−2", "yes", "–", "–", "3e−09", "12"]


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
    with pytest.raises(CraneError, match="no folder can be made"):
        report.write_report(tmp_path / "file" / "x", "T", "V", [])


def test_lines_differ_without_colour():
    lines = example_figure().axes[0].get_lines()
    assert len({str(line._unscaled_dash_pattern) for line in lines}) == len(lines) == 3


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
        "i.length+' '+i.filter(x=>x.complete&&x.naturalWidth>500).length+' '+(document.body.scrollWidth<=innerWidth)})</script>"
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
