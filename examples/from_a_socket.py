"""Samples from a socket at 200 Hz (PORT; without it a crane is played): states with intervals, and the latency."""

import json
import socket
import sys
import threading
import time
from contextlib import suppress

import numpy as np

from crane_exudyn import Crane, simulate
from ukf.estimator import Estimator
from validation.semi_recursive import SemiRecursiveEngine

crane, NOISE = Crane.load("patu655"), {"z1": 9e-4, "z4": 9e-4, "p1": 3e4, "p4": 3e4}


def play(port: int, seconds: float) -> None:
    """Send what a crane's sensors show, a line of JSON each: some twice, some without p4, every 50th cut off."""
    run, random = simulate(crane, engine=SemiRecursiveEngine(crane)), np.random.default_rng(0)
    with socket.create_connection(("127.0.0.1", port)) as line:
        for k in range(1900, 1900 + int(1000 * seconds), 5):
            sample = {n: run[n][k] + random.normal(0.0, s) for n, s in NOISE.items() if k % 55 or n != "p4"}
            text = json.dumps({"t": run.time[k], "u": run.commands[k].tolist(), "y": sample}) + "\n"
            line.sendall(b'{"t": 1.9\n' if k % 250 == 0 else text.encode() * (2 if k % 50 == 0 else 1))
            time.sleep(0.005)


listener = socket.create_server(("127.0.0.1", int(*sys.argv[1:2])))
estimator, took = Estimator(crane, "semi-recursive", NOISE, max_step=2.5e-3), []
if len(sys.argv) < 2:
    threading.Thread(target=play, args=(listener.getsockname()[1], 3.0), daemon=True).start()
with listener, listener.accept()[0] as line, line.makefile() as lines:
    for number, text in enumerate(lines):
        begin = time.perf_counter()
        with suppress(ValueError, KeyError):  # a line that is cut off: the next ones go on
            sample = json.loads(text)
            now = estimator.step(sample["u"], sample["y"], sample["t"])
            took.append(1e3 * (time.perf_counter() - begin))
        if number % 100 == 0:
            print(now)
said = "{} lines, {} no sample, {} samples left out; latency {:.2f} ms (median), {:.2f} ms (99.9 %)"
print(said.format(number + 1, number + 1 - len(took), len(estimator.events), *np.percentile(took[20:], [50.0, 99.9])))
