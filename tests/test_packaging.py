"""What users get: the README's promises, the versions, and the files inside sdist and wheel."""

from __future__ import annotations

import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

import crane_exudyn

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


# -- README ----------------------------------------------------------------------------------------------------------


def readme() -> str:
    return (ROOT / "README.md").read_text()


def test_the_readme_example_runs_and_is_short(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = re.findall(r"```python\n(.*?)```", readme(), re.DOTALL)
    assert len(code) == 1
    assert len([line for line in code[0].splitlines() if line.strip()]) == 6
    monkeypatch.chdir(tmp_path)
    exec(compile(code[0], "README.md", "exec"), {})
    assert crane_exudyn.Recording.load(tmp_path / "heavier.csv").duration == pytest.approx(25.0)


def test_the_recording_in_the_readme_is_one(tmp_path: Path) -> None:
    lines = re.findall(r"^    (time\[s\].*\n(?:    \d.*\n)+)", readme(), re.MULTILINE)
    (tmp_path / "readme.csv").write_text(lines[0].replace("    ", ""))
    assert crane_exudyn.Recording.load(tmp_path / "readme.csv").require().sensors == ("z1", "z4", "p1", "p4")


def test_the_readme_gives_commands_that_exist() -> None:
    from patu.main import COMMANDS

    used = set(re.findall(r"^    patu (\w+)", readme(), re.MULTILINE))
    assert len(used) >= 4 and used <= set(COMMANDS)
    assert "make demo" in readme() and "make test" in readme()


def test_files_that_the_readme_shows_are_there() -> None:
    for link in re.findall(r"\]\((?!http)([^)#]+)", readme()):
        assert (ROOT / link).is_file(), link


# -- versions --------------------------------------------------------------------------------------------------------


def test_one_version_everywhere() -> None:
    version = PROJECT["version"]
    assert crane_exudyn.__version__ == version
    assert f"## {version}" in (ROOT / "CHANGELOG.md").read_text()
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()


def test_every_dependency_that_may_break_has_an_upper_bound() -> None:
    """Arrow numbers a new major version every few months without breaking what is used here; all others are bounded."""
    unbounded = [d for d in PROJECT["dependencies"] if "<" not in d]
    assert [re.split(r"[<>=]", d)[0] for d in unbounded] == ["pyarrow"]


def test_every_dependency_is_imported_somewhere() -> None:
    source = "\n".join(
        p.read_text()
        for package in ("crane_exudyn", "ukf", "validation", "patu")
        for p in (ROOT / package).rglob("*.py")
    )
    module = {"pillow": "PIL"}
    names = {re.split(r"[<>=\[]", d)[0] for d in PROJECT["dependencies"]}
    unused = [n for n in names if not re.search(rf"\b(import|from) {module.get(n, n)}\b", source)]
    assert unused == []


# -- sdist and wheel -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, Path]]:
    """Build both from a copy of the sources, so that nothing is left in the checkout."""
    copy, out = tmp_path_factory.mktemp("sources"), tmp_path_factory.mktemp("dist")
    wanted = ["pyproject.toml", "README.md", "LICENSE", "crane_exudyn", "ukf", "validation", "patu"]
    tar = subprocess.run(["tar", "-c", "--exclude=__pycache__", *wanted], cwd=ROOT, capture_output=True, check=True)
    subprocess.run(["tar", "-x"], cwd=copy, input=tar.stdout, check=True)
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(out), str(copy)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    yield next(out.glob("*.tar.gz")), next(out.glob("*.whl"))


def package_files() -> set[str]:
    """Return the files that must be in a package: all sources and everything that is read at run time."""
    endings = {".py", ".toml", ".j2", ".typed", ".css", ".gz"}
    folders = ("crane_exudyn", "ukf", "validation", "patu")
    return {
        str(p.relative_to(ROOT))
        for f in folders
        for p in (ROOT / f).rglob("*")
        if p.suffix in endings or p.name == "py.typed"
    }


def test_wheel_and_sdist_hold_every_file(built: tuple[Path, Path]) -> None:
    with tarfile.open(built[0]) as sdist:
        in_sdist = {name.partition("/")[2] for name in sdist.getnames()}
    with zipfile.ZipFile(built[1]) as wheel:
        in_wheel = set(wheel.namelist())
    assert package_files() - in_sdist == set()
    assert package_files() - in_wheel == set()
    assert any(name.endswith("licenses/LICENSE") for name in in_wheel)
    assert not any(name.startswith("tests") for name in in_wheel)


def test_the_command_works_from_the_wheel(built: tuple[Path, Path], tmp_path: Path) -> None:
    """The unpacked wheel alone on the path, as in a clean environment that has the dependencies."""
    with zipfile.ZipFile(built[1]) as wheel:
        wheel.extractall(tmp_path / "site")
    code = (
        "import sys; sys.path.insert(0, 'site'); import crane_exudyn, patu.main as m\n"
        "assert 'site' in crane_exudyn.__file__, crane_exudyn.__file__\n"
        "from crane_exudyn.crane import Crane, built_in\n"
        "print(built_in(), [Crane.load(n).name for n in built_in()])\n"
        "m.run(['effects', 'dead_band'])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert "'patu655'" in done.stdout and "dead_band" in done.stdout
