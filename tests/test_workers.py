"""Worker processes: they end with the process that started them, and one that dies is told in one message."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from validation import workers
from validation.workers import in_parallel, results_of, scheduled

TIMEOUT = 20.0


def note_and_sleep(folder: Path, number: int) -> None:
    (folder / str(number)).write_text(str(os.getpid()))
    time.sleep(60)


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def handles_interrupts() -> bool:
    return signal.getsignal(signal.SIGINT) is not signal.SIG_IGN


def alive(pid: int) -> bool:
    """Return whether a process runs; one that has ended and that nobody has waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


def wait_until(condition: object) -> None:
    end = time.monotonic() + TIMEOUT
    while not condition():  # type: ignore[operator]
        assert time.monotonic() < end, "too long"
        time.sleep(0.05)


def test_one_after_the_other_or_in_processes() -> None:
    assert list(results_of([(abs, -1), (abs, -2)], 1)) == [1, 2]
    assert list(results_of([(abs, -1), (abs, -2)], 2)) == [1, 2]
    assert list(results_of([(handles_interrupts,)] * 2, 2)) == [False, False]


OWN = """
from crane_exudyn.effects.base import JOINTS, Effect, Parameter

class WornPin(Effect):
    \"\"\"Torque c omega |omega|.

    Signature: fast moves need more pressure.
    \"\"\"

    name = "worn_pin"
    places = JOINTS
    parameters = (Parameter("c", "N*m*s^2", 0.0, 0.0, 1e5, 2000.0, "drag"),)

    @staticmethod
    def joint_torque(c, omega):
        return -c * omega * abs(omega)
"""
USE = """
import sys
from crane_exudyn.effects import registry
registry.load_effects(sys.argv[1])
from crane_exudyn import Crane
from crane_exudyn.statics import size_of_state  # of a module that is compiled with all effects
from validation.workers import in_parallel
crane = Crane.load("patu655").with_effect("worn_pin@O", {"c": 10.0})
print(*in_parallel(2, [(size_of_state, crane)] * 2))
"""


def test_workers_know_the_users_own_effects_before_they_import_what_is_compiled_with_them(tmp_path: Path) -> None:
    """A task was unpacked first, which imported the engines: every diagnosis with an effect of one's own failed."""
    file = tmp_path / "worn.py"
    file.write_text(OWN)
    run = subprocess.run([sys.executable, "-c", USE, str(file)], capture_output=True, text=True, check=False)
    assert (run.stdout.split(), run.returncode) == (["8", "8"], 0), run.stderr


def writable(array: np.ndarray) -> bool:
    return bool(array.flags.writeable)


def test_what_is_read_only_is_so_in_a_worker() -> None:
    """A machine's table that could be written was another type to compiled code, and each worker compiled for it."""
    table = Crane.load("patu655").machine.topology
    assert not table.flags.writeable and in_parallel(2, [(writable, table)] * 2) == [False, False]


OF_A_SCRIPT = """
from dataclasses import dataclass
from validation.workers import in_parallel

@dataclass
class Case:
    number: int

def doubled(case):
    return Case(2 * case.number)

if __name__ == "__main__":
    print(in_parallel(2, [(doubled, Case(1)), (doubled, Case(2))]))
"""


def test_what_a_script_defines_itself_goes_along_with_its_tasks(tmp_path: Path) -> None:
    """`python -m validation.study run` with two processes had ended with an AttributeError."""
    (tmp_path / "own.py").write_text(OF_A_SCRIPT, encoding="utf-8")
    done = subprocess.run([sys.executable, tmp_path / "own.py"], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "[Case(number=2), Case(number=4)]", done.stderr


def test_workers_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    code = (
        "import sys; sys.path.insert(0, sys.argv[2])\n"
        "from pathlib import Path; from test_workers import note_and_sleep; from validation.workers import results_of\n"
        "list(results_of([(note_and_sleep, Path(sys.argv[1]), k) for k in (0, 1)], 2))"
    )
    here = str(Path(__file__).parent)
    parent = subprocess.Popen([sys.executable, "-c", code, str(tmp_path), here])
    try:
        wait_until(lambda: len([p for p in tmp_path.iterdir() if p.read_text()]) == 2)
        workers = [int(p.read_text()) for p in tmp_path.iterdir()]
        assert all(alive(pid) for pid in workers)
    finally:
        parent.kill()
        parent.wait()
    wait_until(lambda: not any(alive(pid) for pid in workers))


@pytest.mark.filterwarnings("ignore")  # joblib complains of what the dead worker left behind
def test_a_worker_that_was_killed_is_one_message() -> None:
    with pytest.raises(CraneError, match="ended from outside"):
        list(results_of([(die,), (die,)], 2))


def process() -> int:
    return os.getpid()


def test_a_scheduler_takes_the_work_and_gives_the_same_results() -> None:
    tasks = [(process,), (abs, -2)]
    with scheduled("local"):
        pid, two = in_parallel(1, tasks)
        assert next(results_of([(process,)], 1)) != os.getpid()
    assert pid != os.getpid() and two == 2
    assert in_parallel(1, tasks) == [os.getpid(), 2], "afterwards work is done here again"


def test_a_scheduler_that_does_not_answer_is_one_message(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "ANSWER", 0.5)
    with pytest.raises(CraneError, match="No Dask scheduler answers"), scheduled("tcp://127.0.0.1:1"):
        pass
