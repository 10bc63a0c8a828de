"""Compare the widths that the flow design predicts with those of simulated capsules, identified one by one.

Run ``python -m evidence.benchmarks.sensitivity [CAPSULES]``. Each row is one mean velocity of a design. The target is a
prediction within 10 % of the mean width. The last column says whether the posterior leans on the border of the
database, whether the rear is convex (L_p = 0), and whether two shapes are stable.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from capsbayes.experiment import Experiment
from capsbayes.infer.verdict import LEANING_SHARE
from capsbayes.model import TWO_SHAPES
from capsbayes.plan import FlowDesign, FlowPoint, LabErrors, SimulatedWidths, flow_design, simulated_widths
from capsbayes.quantity import Quantity
from capsbayes.surrogate import Surrogate
from evidence.benchmarks.stored import arguments
from evidence.markdown import table

MODULUS = 0.05  # N/m
SIZES = (0.85, 0.96, 1.05)
ERRORS = (0.02, 0.005)  # of the lengths, over l
ROWS = 9  # velocities of each design
WANTED = 0.10
HEAD = ("U mm/s", "Ca", "predicted %", "simulated %", "off", "without noise", "in 68 %", "")


@dataclass(frozen=True)
class Lab:
    """A lab and the capsules that it expects."""

    name: str
    experiment: Experiment
    modulus: Any
    radius: Any
    errors: LabErrors


def labs() -> Iterator[Lab]:
    half_width = Quantity(25e-6, 0.2e-6)
    experiment = Experiment(cross_section="square", half_width=half_width, viscosity=Quantity(0.85, 0.02))
    for error in ERRORS:
        errors = LabErrors(axial_extent=error, axial_length=error, capsule_velocity=0.01)
        for size in SIZES:
            yield Lab(f"a/l = {size}, L +/- {error:g} l", experiment, MODULUS, size * 25e-6, errors)
    spread = Quantity(MODULUS, 0.2 * MODULUS), Quantity(24e-6, 0.5e-6)
    errors = LabErrors(axial_extent=0.02, axial_length=0.02, capsule_velocity=0.01)
    yield Lab("G_s +/- 20 %, a +/- 2 %, L +/- 0.02 l", experiment, *spread, errors)
    metres = LabErrors(
        axial_extent=0.5e-6, axial_length=0.5e-6, capsule_velocity=0.01, length_correlation=0.5, over_half_width=False
    )
    yield Lab("a/l = 0.96, L +/- 0.5 um, correlated 0.5", experiment, MODULUS, 24e-6, metres)
    tube = Experiment(cross_section="circular", half_width=half_width, viscosity=Quantity(0.85, 0.02))
    yield Lab("tube, a/l = 0.9, L +/- 0.02 l", tube, MODULUS, 0.9 * 25e-6, errors)


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("capsules", nargs="?", type=int, default=150, help="number of capsules of each row")
    capsules = parser.parse_args().capsules
    counts: dict[str, list[tuple[bool, bool]]] = {"all": [], "allowed": [], "allowed, one shape, L_p > 0": []}
    for lab in labs():
        model = Surrogate.open(f"{lab.experiment.cross_section}-neo-hookean")
        design = flow_design(lab.modulus, lab.radius, lab.experiment, lab.errors, model, seed=1)
        rows = []
        for point in chosen(design):
            found = simulated_widths(
                lab.modulus,
                lab.radius,
                lab.experiment,
                lab.errors,
                model,
                mean_velocity=point.mean_velocity,
                count=capsules,
                seed=2,
            )
            where = kinds(point, model, design)
            good, plain = (abs(one / found.mean - 1.0) <= WANTED for one in (point.relative, point.noise_free))
            for name, belongs in zip(counts, (True, point.allowed, point.allowed and not where), strict=True):
                if belongs:
                    counts[name].append((good, plain))
            rows.append([*cells(point, found, good), ", ".join(where) + (" BEST" if point is design.best else "")])
        print(f"{lab.name}\n\n{table(HEAD, rows)}\n", flush=True)
    for name, found in counts.items():
        good, plain = (sum(column) for column in zip(*found, strict=True))
        print(f"{name}: {good} of {len(found)} within {WANTED:.0%}, {plain} by the measurement without noise")


def chosen(design: FlowDesign) -> list[FlowPoint]:
    """Return some velocities, evenly spaced in the logarithm of Ca, and the best one."""
    rows = {round(row) for row in np.linspace(4, len(design.points) - 4, ROWS - 1)}
    if design.best is not None:
        rows.add(design.points.index(design.best))
    return [design.points[row] for row in sorted(rows)]


def kinds(point: FlowPoint, model: Surrogate, design: FlowDesign) -> list[str]:
    """Return the special conditions at the position of the expected capsule."""
    place = {"capillary_number": [point.capillary_number], "size_ratio": [design.limit.size_ratio]}
    there = model({name: np.array(value) for name, value in place.items()})
    marks = {
        "two shapes": model.caveats(place).get(TWO_SHAPES, np.zeros(1, dtype=bool))[0],
        "L_p = 0": there.parachute_depth[0] < 1e-4,
        "leans": point.leaning > LEANING_SHARE,
    }
    return [name for name, holds in marks.items() if holds]


def cells(point: FlowPoint, found: SimulatedWidths, good: bool) -> list[str]:
    return [
        f"{1e3 * point.mean_velocity:.3g}",
        f"{point.capillary_number:.3g}",
        f"{100 * point.relative:.1f}",
        f"{100 * found.mean:.1f} +/- {100 * found.standard_error:.1f}",
        f"{100 * (point.relative / found.mean - 1):+.1f} %" + ("" if good else " !"),
        f"{100 * (point.noise_free / found.mean - 1):+.0f} %",
        f"{100 * found.within.mean():.0f} %",
    ]


if __name__ == "__main__":
    main()
