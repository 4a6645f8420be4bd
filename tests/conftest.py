"""What all tests share."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import pytest


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile everything once, before several processes would each do it for themselves."""
    if getattr(session.config.option, "numprocesses", None):  # of the process that hands out the tests, with pytest -n
        from patu.compiling import compile_for

        compile_for("exudyn", "semi-recursive", "filter", "fit")


@pytest.fixture(autouse=True, scope="session")
def _own_list_of_written_files(tmp_path_factory: pytest.TempPathFactory) -> object:
    """Keep what tests write out of the user's list of files that `patu` wrote."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield


class Ended(SimpleNamespace):
    """A finished run of `patu`: status, out, err."""


@pytest.fixture
def patu(capsys: pytest.CaptureFixture[str]) -> Callable[..., Ended]:
    """Run one command line in this process, as the shell would."""
    from patu import main

    def call(*words: str) -> Ended:
        with pytest.raises(SystemExit) as leaving:
            main.run(words)
        captured = capsys.readouterr()
        return Ended(status=leaving.value.code, out=captured.out, err=captured.err)

    return call
