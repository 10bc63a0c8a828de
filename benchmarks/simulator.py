"""Time and memory of a steady state from a neighbouring one, and the mesh's error, in printed tables.

Run ``python benchmarks/simulator.py``. One core; compilation and the walls'
factorisation are done before the clock starts. The neighbours are those of a
database: one step in Ca.
"""

from __future__ import annotations

import resource
import time

import numpy as np
from rich.console import Console
from rich.table import Table

from capsbayes import Simulator
from capsbayes.membrane import NeoHookean
from capsbayes.simulation.rigid import rigid_sphere
from capsbayes.simulation.steady_state import SteadyProblem
from capsbayes.stokes.channel import SquareChannel
from capsbayes.stokes.walls import Walls

COLUMNS = {0.8: (0.04, 0.05, 0.06, 0.08, 0.1), 0.95: (0.04, 0.05, 0.06, 0.07, 0.08, 0.09), 1.1: (0.03, 0.04, 0.05)}
CAPSULE = {"capillary_number": 0.082, "size_ratio": 0.96}
RIGID = {
    0.3: (1.990163, 0.024220),
    0.5: (1.808701, 0.320879),
    0.7: (1.563738, 1.94190),
    0.8: (1.42899, 4.3363),
    0.85: (1.36050, 6.5400),
    0.9: (1.2916, 10.198),
}


def speed(refinement: int) -> tuple[np.ndarray, np.ndarray]:
    """Seconds and Newton steps of every steady state from its neighbour."""
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


def shape(simulator: Simulator) -> np.ndarray:
    """L_z, L_a, v_o/U, dP+ of the capsule of the paper."""
    state = simulator.run(**CAPSULE)
    profile = state.profile
    return np.array([profile.axial_extent, profile.axial_length, state.velocity_ratio, state.extra_pressure_drop])


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

    table = Table("refinement / walls", "L_z/l", "L_a/l", "v_o/U", "dP+ l/(mu U)")
    table.title = "the paper's capsule, Ca = 0.082, a/l = 0.96 (paper: 2.14, 1.81, 1.29)"
    for refinement in (6, 8, 12):
        table.add_row(str(refinement), *(f"{value:.4f}" for value in shape(Simulator(refinement=refinement))))
    for walls in (Walls(spacing=0.065, far_spacing=0.13), Walls(end=4.0)):
        values = shape(Simulator(refinement=8, walls=walls))
        table.add_row(f"8, spacing {walls.spacing}, end {walls.end}", *(f"{value:.4f}" for value in values))
    console.print(table)

    table = Table("a/l", "V/U", "reference", "dP+", "reference")
    table.title = "rigid sphere on the axis, refinement 12"
    for size_ratio, (velocity, drop) in RIGID.items():
        motion = rigid_sphere(SteadyProblem(NeoHookean(), SquareChannel(), 12, 0.0), size_ratio)
        values = (f"{motion.velocity_ratio:.6f}", f"{velocity}", f"{motion.extra_pressure_drop:.5f}", f"{drop}")
        table.add_row(str(size_ratio), *values)
    console.print(table)


if __name__ == "__main__":
    main()
