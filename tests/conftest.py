"""What all tests share."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True, scope="session")
def _own_list_of_written_files(tmp_path_factory: pytest.TempPathFactory) -> object:
    """Keep what tests write out of the user's list of files that `patu` wrote."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        yield
