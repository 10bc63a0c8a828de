"""What the two bending energies do: beside an independent shell, in a square channel, and in a tube as B falls.

``python -m evidence.benchmarks.bending`` computes what is missing of ``evidence/results/bending.json``; ``--write``
renews the tables in ``evidence/results/bending.md``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import curve_fit

from capsbayes import Simulator
from capsbayes.arrays import Floats
from capsbayes.physics.continuation import parachute
from capsbayes.physics.load import profile
from capsbayes.physics.steady import Iterate, steady_state
from capsbayes.physics.surface import prolonged
from evidence.benchmarks.stored import ROOT, Stored, with_write
from evidence.markdown import table
from evidence.verification.quantities import fitted_rate

ENERGIES = ("displacement", "curvature")
SHELL = [(height, n) for height in (0.8, 0.5) for n in (6, 8, 12)]
CHANNEL = [  # refinement, Ca, a/l, B
    (8, 0.02, 0.75, 2e-4),
    (8, 0.1, 0.7, 2e-4),
    *((8, 0.05, 0.9, bending) for bending in (2e-4, 1e-3)),
    (8, 0.08, 0.95, 1e-3),
    *((n, 0.08, 0.95, 2e-4) for n in (8, 10, 12)),
]
TUBE, UNBENT = (0.02, 0.8), (1.49586, 1.36403)  # Ca, a/R; L_z/R, L_a/R
MESHES, BENDINGS = (6, 8, 12, 16, 20, 24), (2e-4, 1e-4, 5e-5, 2e-5, 1e-5, 5e-6)
Row = list[float]


def shell(height: float, refinement: int) -> Row:
    """Return the rms distance from the independent shell for each energy."""
    sys.path.insert(0, str(ROOT / "tests" / "support"))
    from pressed_shell import distances

    return [float(np.sqrt(np.mean(distances(refinement, energy, height) ** 2))) for energy in ENERGIES]


def sharpest(points: Floats) -> float:
    """Return the smallest radius of curvature of an outline (p, 2)."""
    length = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
    spline, along = CubicSpline(length, points), np.linspace(0.01, 0.99, 4000) * length[-1]
    first, second = spline(along, 1), spline(along, 2)
    bend = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    return float(1.0 / np.max(bend / np.hypot(*first.T) ** 3))


def channel(refinement: int, capillary_number: float, size_ratio: float, bending: float) -> Row:
    """Return L_z, L_a, V and the smallest radius of the mid-plane for each energy, over l and U."""
    row = []
    for energy in ENERGIES:
        simulator = Simulator(refinement=refinement, bending=bending, bending_energy=energy)
        state = simulator.run(capillary_number=capillary_number, size_ratio=size_ratio, start="parachute")
        assert state.status.ok, state.status
        outline = state.profile
        row += [outline.axial_extent, outline.axial_length, state.velocity_ratio, sharpest(outline.points)]
    return row


@cache
def tube_state(refinement: int, bending: float) -> Iterate:
    """Return the parachute in the tube, from that with the next larger B."""
    simulator = Simulator(cross_section="circular", refinement=refinement, bending=bending, bending_energy="curvature")
    problem, place = simulator.problem, BENDINGS.index(bending)
    if place:
        start = tube_state(refinement, BENDINGS[place - 1])
    elif refinement > 8:
        coarse = tube_state(8, bending)
        start = replace(coarse, free=prolonged(coarse.free, replace(problem, refinement=8).mesh, problem.mesh))
    else:
        start = parachute(problem, *TUBE).result.iterate
    result = steady_state(problem, start)
    assert result.converged
    return result.iterate


def tube(refinement: int, bending: float) -> Row:
    """Return L_z, L_a and V in the tube with the energy of curvature."""
    iterate = tube_state(refinement, bending)
    mesh = Simulator(cross_section="circular", refinement=refinement).problem.mesh
    outline = profile(mesh, mesh.expanded(iterate.free))
    return [outline.axial_extent, outline.axial_length, float(iterate.velocity)]


def tasks() -> Iterator[tuple[str, Callable[[], Row]]]:
    """Yield every result by its name."""
    for n in MESHES:
        for bending in BENDINGS:
            yield f"tube {n} {bending:g}", partial(tube, n, bending)
    for case in CHANNEL:
        yield "channel {:d} {:g} {:g} {:g}".format(*case), partial(channel, *case)
    for setting in SHELL:
        yield "shell {:g} {:d}".format(*setting), partial(shell, *setting)


def limit(known: dict[str, Row], quantity: int) -> tuple[float, float]:
    """Return L_0 and p of L = L_0 - c B^p, fitted to L_z (0) or L_a (1) on the finest mesh."""
    values = [known[f"tube {MESHES[-1]} {bending:g}"][quantity] for bending in BENDINGS]
    fitted, _ = curve_fit(lambda b, end, c, p: end - c * b**p, BENDINGS, values, p0=(UNBENT[quantity], 0.3, 0.4))
    return float(fitted[0]), float(fitted[2])


def differences(row: Row) -> str:
    """Return how far L_z and L_a are from those without bending."""
    return ", ".join(f"{100 * (value / truth - 1):+.2f}" for value, truth in zip(row[:2], UNBENT, strict=True))


def tables(known: dict[str, Row]) -> dict[str, str]:
    """Return the tables of the shell, of the channel, of the tube, and of the limits of its lengths."""
    shell_rows = [[f"{height:g}", str(n), *map("{:.2e}".format, known[f"shell {height:g} {n}"])] for height, n in SHELL]
    meshes, heights = sorted({n for _, n in SHELL}), sorted({height for height, _ in SHELL})
    for height in heights:
        p = fitted_rate(meshes, [known[f"shell {height:g} {n}"][1] for n in meshes])
        shell_rows.append([f"{height:g}", "rate", "", f"{p:.1f}"])
    channel_rows = [
        [*map("{:g}".format, case), energy, *map("{:.4f}".format, values)]
        for case in CHANNEL
        for energy, values in zip(
            ENERGIES, np.reshape(known["channel {:d} {:g} {:g} {:g}".format(*case)], (2, 4)), strict=True
        )
    ]
    tube_rows = [
        [f"{bending:g}", *(differences(known[f"tube {n} {bending:g}"]) for n in MESHES)] for bending in BENDINGS
    ]
    limits = [(name, *limit(known, quantity), UNBENT[quantity]) for quantity, name in enumerate(("L_z/R", "L_a/R"))]
    limit_rows = [[name, f"{end:.4f}", f"{100 * (end / truth - 1):+.3f}", f"{p:.2f}"] for name, end, p, truth in limits]
    return {
        "shell": table(("height", "refinement", "displacement", "curvature"), shell_rows),
        "channel": table(("n", "Ca", "a/l", "B", "energy", "L_z", "L_a", "v_o/U", "rim"), channel_rows),
        "tube": table(("B", *(f"n = {n}" for n in MESHES)), tube_rows),
        "limits": table(("", "limit", "from that without bending, %", "p"), limit_rows),
    }


STORED = Stored("bending.json", "evidence/results/bending.md", tables)


def main() -> None:
    given = with_write(__doc__).parse_args()
    STORED.show(STORED.completed(tasks()), write=given.write)


if __name__ == "__main__":
    main()
