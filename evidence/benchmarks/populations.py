"""Many capsules: time and memory by their number, and coverage of the intervals of populations.

Run ``python -m evidence.benchmarks.populations [scale|coverage|selection] [--numbers 1000,10000] [--sessions 500]``.
Scale: tables of lengths of drawn capsules, identified by `identify_folder` in two processes, each number in a process
of its own; wall time, processor time and largest memory of all processes together. Coverage: sessions of 150 and 1000
capsules with a viscosity known to 5 % and a half width known to 1 %, and how often 95 % intervals of the population
contain the truth; also with viscosity and half width taken as exact. Selection: only capsules above Lambda = 1.08, with
the cut ignored and accounted for.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from functools import cache, partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd
import psutil
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table
from scipy import stats

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "support"))
from drawn_populations import EXPERIMENT, TRUTH, drawn_population, measured

from capsbayes.infer.batch import identify_folder
from capsbayes.infer.hierarchy import hierarchy
from capsbayes.infer.population import Population
from capsbayes.infer.selection import kept_rows
from capsbayes.surrogate import Surrogate

ROOT = Path(__file__).parents[2]
NUMBERS = (1_000, 10_000, 100_000, 1_000_000)
CAPSULES, CUT = 150, 1.08


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", nargs="?", choices=("scale", "coverage", "selection", "one"))
    parser.add_argument("--numbers", default="1000,10000")
    parser.add_argument("--sessions", type=int, default=40)
    given = parser.parse_args()
    if given.what == "one":
        print(json.dumps(one(int(given.numbers))))
        return
    console = Console(width=150)
    if given.what in (None, "scale"):
        scale([int(number) for number in given.numbers.split(",")], console)
    if given.what in (None, "coverage"):
        coverage(given.sessions, console)
    if given.what in (None, "selection"):
        selection(max(given.sessions // 2, 10), console)


def scale(numbers: list[int], console: Console) -> None:
    table = Table("capsules", "wall [s]", "a second", "processor [s]", "peak memory [GiB]", "rows done", box=SIMPLE)
    for number in numbers:
        run = subprocess.run(
            [sys.executable, "-m", "evidence.benchmarks.populations", "one", "--numbers", str(number)],
            capture_output=True,
            text=True,
            check=True,
            cwd=ROOT,
        )
        found = json.loads(run.stdout.splitlines()[-1])
        rate = f"{number / found['wall']:.0f}"
        cells = (f"{found['wall']:.1f}", rate, f"{found['processor']:.1f}", f"{found['memory']:.2f}")
        table.add_row(f"{number:,}", *cells, f"{found['done']:.1%}")
    console.print(table)


def one(number: int) -> dict[str, float]:
    """Identify a table of a given number of capsules."""
    model = Surrogate.open("square-neo-hookean")
    lengths, velocities = measured(model, number, seed=1)
    frame = pd.DataFrame(
        {
            "axial_extent_over_l": lengths[:, 0],
            "axial_extent_error_over_l": np.sqrt(lengths[:, 2]),
            "axial_length_over_l": np.minimum(lengths[:, 1], lengths[:, 0]),
            "axial_length_error_over_l": np.sqrt(lengths[:, 4]),
            "capsule_velocity_m_per_s": velocities[:, 0],
            "capsule_velocity_error_m_per_s": velocities[:, 1],
        }
    )
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "capsules.csv"
        frame.to_csv(source, index=False)
        del frame, lengths, velocities
        start = time.perf_counter()
        with PeakMemory() as memory:
            found = identify_folder(source, model, EXPERIMENT, out=Path(folder) / "r.nc", seed=1, check=0.0, workers=2)
        wall = time.perf_counter() - start
    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    processor = sum(one.ru_utime + one.ru_stime for one in (own, children))
    return {"wall": wall, "processor": processor, "memory": memory.peak / 2**30, "done": float(found.usable.mean())}


class PeakMemory:
    """Largest resident memory of this process and its children together, seen every tenth of a second.

    What getrusage tells of a child begins with the memory of the process that started it.
    """

    def __init__(self) -> None:
        self.peak = 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def __enter__(self) -> PeakMemory:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _watch(self) -> None:
        this = psutil.Process()
        while not self._ended.wait(0.1):
            total = 0
            for process in (this, *this.children(recursive=True)):
                with contextlib.suppress(psutil.NoSuchProcess):
                    total += process.memory_info().rss
            self.peak = max(self.peak, total)


@cache
def model() -> Surrogate:
    return Surrogate.open("square-neo-hookean")


def intervals(seed: int, *, capsules: int = CAPSULES) -> dict[str, bool]:
    """Return whether each interval of one session contains the truth."""
    found = hierarchy(drawn_population(model(), capsules, seed), seed=seed)
    held = {name: found.marginals[name].contains(truth, level=95) for name, truth in TRUTH.items()}
    for name, draws in found.without_shared.items():
        low, high = np.quantile(draws, [0.025, 0.975])
        held[f"{name}, shared errors ignored"] = bool(low <= TRUTH[name] <= high)
    return held | {"gates": found.passed}


def selected(seed: int) -> dict[str, bool]:
    whole = drawn_population(model(), CAPSULES, seed)
    only = Population(whole.dataset.isel(capsule=np.flatnonzero(kept_rows(whole, CUT))))
    held = {}
    for words, found in (
        ("cut ignored", hierarchy(only, seed=seed)),
        ("accounted for", hierarchy(whole, seed=seed, least_stretch=CUT, model=model())),
    ):
        for name, truth in TRUTH.items():
            held[f"{name}, {words}"] = found.marginals[name].contains(truth, level=95)
    return held


def coverage(sessions: int, console: Console) -> None:
    for capsules in (CAPSULES, 1000):
        number = sessions if capsules == CAPSULES else max(sessions // 5, 10)
        counted(f"{number} sessions of {capsules} capsules", partial(intervals, capsules=capsules), number, console)


def selection(sessions: int, console: Console) -> None:
    counted(f"{sessions} sessions of {CAPSULES} capsules, those above Lambda = {CUT} kept", selected, sessions, console)


def counted(title: str, session: Any, number: int, console: Console) -> None:
    with ProcessPoolExecutor(2) as pool:
        found = list(pool.map(session, range(number)))
    table = Table("", "95 % intervals that hold the truth", "of", "share", title=title, box=SIMPLE)
    for name in found[0]:
        held = sum(one[name] for one in found)
        low, high = stats.binomtest(held, number).proportion_ci()
        table.add_row(name, str(held), str(number), f"{held / number:.1%} [{low:.1%}, {high:.1%}]")
    console.print(table)


if __name__ == "__main__":
    main()
