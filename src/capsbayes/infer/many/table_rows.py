"""Rows of a table of lengths from the tabulated model; those that it does not resolve are left to the exact engine."""

from __future__ import annotations

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.experiment import Experiment
from capsbayes.infer.grid.quadrature import FARTHEST
from capsbayes.infer.inputs import Inputs
from capsbayes.infer.many.capsule_rows import LEANINGS, CapsuleRows
from capsbayes.infer.many.run import Run
from capsbayes.infer.many.tabulated.row_kernel import QUANTITIES
from capsbayes.infer.many.tabulated.rows import lengths_rows
from capsbayes.infer.many.tabulated.search import FAR, FOUND
from capsbayes.infer.misfit import PREDICTED, inertia, misfits_of
from capsbayes.infer.verdict import leaning_status
from capsbayes.measurement import CONDITIONS
from capsbayes.measurements.table import NUMBERS, MeasuredLengths
from capsbayes.status import Status

_MEDIAN = 2  # of the statistics of a `Marginal`
_ALL_WITHIN = 1.0 - 1e-6  # share of a posterior within the prior ranges, below which the exact engine takes over


def rows_of_table(measured: MeasuredLengths, run: Run, experiment: Experiment) -> tuple[CapsuleRows, list[int]]:
    """Compute the rows of a table; return the numbers of those that the lattices do not resolve, too."""
    count = len(measured)
    numbers = np.stack([measured.numbers[name] for name in NUMBERS], axis=1)
    source = np.full(count, measured.source, dtype=object)
    rows = CapsuleRows.empty(measured.names.astype(object), source, np.full(count, measured.sha256, object), numbers)
    usable = np.flatnonzero(measured.refusals == "")
    _refuse(rows, measured)
    if run.model.coordinates or run.prior.is_general:  # beyond the compiled rows
        return rows, usable.tolist()
    by_rate = np.isnan(measured.velocities[usable, 0])
    usable, exact = usable[~by_rate], usable[by_rate].tolist()
    if not len(usable):
        return rows, exact
    shifts = np.stack([_own(measured, name, experiment) for name in reversed(CONDITIONS)], axis=1)
    found = lengths_rows(
        measured.lengths[usable],
        measured.velocities[usable],
        Inputs.of_experiment(experiment),
        run.prior,
        run.pyramid,
        rates=measured.rates[usable],
        shifts=shifts[usable],
    )
    facts = found.facts
    rows.engine[usable] = "table"
    rows.summaries[usable], rows.components[usable] = found.summaries, found.components
    rows.distance[usable] = facts["distance"]
    rows.leaning[usable] = np.stack(
        [facts["border"], 1.0 - np.minimum(facts["within"], 1.0), *(facts[name] for name in LEANINGS[2:])], axis=1
    )
    rows.p_values[usable] = np.stack([facts[name] for name in PREDICTED], axis=1)
    velocity = rows.summaries[usable, QUANTITIES.index("mean_velocity"), _MEDIAN]
    viscosity, half_width = np.exp(shifts[usable]).T
    rows.reynolds_number[usable] = experiment.reynolds_number(velocity) * half_width / viscosity
    rows.status[usable] = [_status(rows, row).name for row in usable.tolist()]
    far = usable[facts["end"] == FAR]
    rows.status[far] = Status.NO_SHAPE.name
    rows.reason[far] = [f"{rows.distance[row]:.1f} standard errors away, {FARTHEST:g} at most" for row in far]
    rows.leaning[far] = np.nan
    resolved = (facts["end"] == FOUND) & (facts["within"] >= _ALL_WITHIN)
    own = np.array([bool(measured.prior_texts(row)) for row in usable.tolist()], dtype=bool)
    return rows, sorted([*exact, *usable[(~resolved & (facts["end"] != FAR)) | own].tolist()])


def _status(rows: CapsuleRows, row: int) -> Status:
    """Return the status of a row that the lattices resolve."""
    misfits = [*misfits_of(dict(zip(PREDICTED, rows.p_values[row], strict=True))), inertia(rows.reynolds_number[row])]
    failed = (misfit.status for misfit in misfits if not misfit.gate.passed)
    return next(failed, None) or leaning_status(rows.leaning[row])


def _refuse(rows: CapsuleRows, measured: MeasuredLengths) -> None:
    """Set status and reason of the rows that cannot be used; a row may bring the status of its measurement."""
    for row in np.flatnonzero(measured.refusals != ""):
        why = str(measured.refusals[row])
        status = why.removeprefix("status: ")
        known = status in Status.__members__ and status != why
        rows.status[row] = status if known else Status.UNUSABLE.name
        rows.reason[row] = "" if known else why


def _own(measured: MeasuredLengths, name: str, experiment: Experiment) -> Floats:
    """Return the logarithm of a condition of each capsule over that of the experiment, zero where it is the same."""
    usual = getattr(experiment, name).mean
    return np.nan_to_num(np.log(measured.numbers[name] / usual))
