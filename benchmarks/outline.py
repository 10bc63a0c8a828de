"""Coverage of the posterior from a whole outline, and its width compared with that from the lengths.

Run ``python benchmarks/outline.py [CAPSULES]``. In the first row the outlines
come from the surrogate that identifies them. In the second they are the
simulator's own shapes, at a/l that were omitted from the surrogate:
its error there must be within the error that it states.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from capsbayes import Database, Experiment, MeasuredOutline, Measurement, OutlineNoise, Surrogate
from capsbayes.infer import Quadrature
from capsbayes.profile import Profile, vertex_normals

NOISE = OutlineNoise(0.006, 0.4, 0.1)
FLOW, EXPERIMENT = 4e-3, Experiment(cross_section="square", half_width=50e-6, viscosity=0.7)
LEVELS = (0.5, 0.68, 0.95)
Case = tuple[float, float, np.ndarray, float]  # Ca, a/l, outline, v_o/U


def measured(case: Case, rng: np.random.Generator) -> Measurement:
    """Return the outline of a case with errors, and its lengths."""
    _, _, outline, velocity_ratio = case
    vertices = outline[::4]
    points = vertices + NOISE.drawn(rng, vertices, 1)[0][:, None] * vertex_normals(outline)[::4]
    seen = Profile.from_outline(points)
    error = 1.5 * NOISE.scale
    return Measurement(
        axial_extent=seen.axial_extent,
        axial_extent_error=error,
        axial_length=seen.axial_length,
        axial_length_error=error,
        capsule_velocity=FLOW * velocity_ratio,
        capsule_velocity_error=1e-4 * FLOW,
        outline=MeasuredOutline(points, NOISE),
    )


def covered(model: Surrogate, drawn: Callable[[], Case], count: int, rng: np.random.Generator) -> list[str]:
    """Return the shares of the intervals of G_s and a that contain the truth."""
    engine, ranks, seconds = Quadrature(model, EXPERIMENT), np.empty((count, 2)), 0.0
    for number in range(count):
        case = drawn()
        seen = measured(case, rng)
        start = time.process_time()
        posterior = engine(seen)
        seconds += time.process_time() - start
        truth = EXPERIMENT.viscosity.value * FLOW / case[0], case[1] * EXPERIMENT.half_width.value
        names = ("surface_shear_modulus", "capsule_radius")
        ranks[number] = [posterior.probability_below(*pair) for pair in zip(names, truth, strict=True)]
    cells = []
    for level in LEVELS:
        share = np.mean(np.abs(ranks - 0.5) < level / 2, axis=0)
        error = np.sqrt(level * (1 - level) / count)
        cells.append(f"{share[0]:.3f}, {share[1]:.3f} (+/- {error:.3f})")
    return [str(count), *cells, f"{1e3 * seconds / count:.0f}"]


def main() -> None:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    database, rng = Database.open("square-neo-hookean"), np.random.default_rng(1)
    whole = Surrogate(database)

    def from_surrogate() -> Case:
        ca, size = rng.uniform(0.03, 0.09), rng.uniform(0.78, 1.0)
        there = whole.at(capillary_number=ca, size_ratio=size, outline=True)
        return ca, size, there.outline[0], float(there.velocity_ratio[0])

    cases = database.converged
    sizes = np.round(cases["size_ratio"], 6)
    left_out = np.isin(sizes, np.unique(sizes)[1::2])
    half = Surrogate(Database(cases.dataset.isel(case=np.flatnonzero(~left_out))))
    ca = cases["capillary_number"]
    rows = np.flatnonzero(left_out & (ca > 0.0299) & (ca < 0.0901) & (sizes > 0.76) & (sizes < 1.01))

    def simulated() -> Case:
        row = rng.choice(rows)
        return ca[row], sizes[row], cases["profile"][row], float(cases["velocity_ratio"][row])

    table = Table(title="share of the intervals of G_s, a that hold the truth")
    for heading in ("outlines from", "capsules", *(f"{level:.0%}" for level in LEVELS), "ms each"):
        table.add_column(heading)
    with threadpool_limits(limits=1):
        table.add_row("the surrogate itself", *covered(whole, from_surrogate, count, rng))
        table.add_row("simulations left out of it", *covered(half, simulated, count, rng))
    Console().print(table)


if __name__ == "__main__":
    main()
