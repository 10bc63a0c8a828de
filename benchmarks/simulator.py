"""Time of a steady state by Newton's method and by time steps, in printed tables.

Run ``python benchmarks/simulator.py``. One core; compilation and the walls'
factorisation are done before the timing. The neighbours are those of a
database: one step in Ca. ``capsbayes verify`` tests the accuracy.
"""

from __future__ import annotations

import resource
import time

import numpy as np
from rich.console import Console
from rich.table import Table

from capsbayes import Simulator
from capsbayes.physics.load import profile
from capsbayes.physics.transient import transient

COLUMNS = {0.8: (0.04, 0.05, 0.06, 0.08, 0.1), 0.95: (0.04, 0.05, 0.06, 0.07, 0.08, 0.09), 1.1: (0.03, 0.04, 0.05)}


def speed(refinement: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the seconds and Newton steps of every steady state from its neighbour."""
    simulator = Simulator(refinement=refinement)
    seconds, steps = [], []
    for size_ratio, capillary_numbers in COLUMNS.items():
        state = simulator.run(capillary_number=capillary_numbers[0], size_ratio=size_ratio)
        for capillary_number in capillary_numbers[1:]:
            begin = time.perf_counter()
            state = simulator.run(capillary_number=capillary_number, size_ratio=size_ratio, start=state)
            seconds.append(time.perf_counter() - begin)
            steps.append(state.iterations)
    return np.array(seconds), np.array(steps)


def ways(refinement: int) -> list[tuple[str, float, float, float]]:
    """Return the ways to the steady shape at Ca = 0.12, a/l = 0.9: name, seconds, L_z and v_o/U."""
    simulator, case = Simulator(refinement=refinement), {"capillary_number": 0.12, "size_ratio": 0.9}
    neighbour = simulator.run(**case | {"capillary_number": 0.11})
    begin = time.process_time()
    state = simulator.run(**case, start=neighbour)
    rows = [("Newton from Ca = 0.11", time.process_time() - begin, state.profile.axial_extent, state.velocity_ratio)]
    problem = simulator.problem
    for scheme in ("semi-implicit", "explicit"):
        begin = time.process_time()
        (end,) = transient(problem, problem.at_rest(*case.values()), [50.0], scheme=scheme, steady=1e-3)
        seconds = time.process_time() - begin
        outline = profile(problem.mesh, problem.mesh.expanded(end.iterate.free))
        rows.append((f"{scheme} to t = {end.time:.1f}", seconds, outline.axial_extent, end.iterate.velocity))
    return rows


def main() -> None:
    console = Console()
    table = Table("refinement", "cases", "median s", "largest s", "median steps", "peak memory MiB")
    table.title = "steady state from a neighbouring one, one core"
    for refinement in (8, 12):
        seconds, steps = speed(refinement)
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        row = (len(seconds), f"{np.median(seconds):.2f}", f"{seconds.max():.2f}", np.median(steps), f"{memory:.0f}")
        table.add_row(str(refinement), *map(str, row))
    console.print(table)

    table = Table("refinement", "way", "s", "times Newton's", "L_z/l", "v_o/U")
    table.title = "steady shape at Ca = 0.12, a/l = 0.9: by Newton's method, and in time from rest to speeds < 1e-3"
    for refinement in (6,):  # the explicit steps of a finer mesh take half an hour
        rows = ways(refinement)
        for way, seconds, extent, velocity in rows:
            ratio = seconds / rows[0][1]
            table.add_row(str(refinement), way, f"{seconds:.1f}", f"{ratio:.0f}", f"{extent:.4f}", f"{velocity:.4f}")
    console.print(table)


if __name__ == "__main__":
    main()
