"""Row of one capsule by the exact engine."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError, NoShapeError
from capsbayes.experiment import Experiment
from capsbayes.infer.grid.posterior import GridPosterior
from capsbayes.infer.identify import check_applies
from capsbayes.infer.inputs import Inputs
from capsbayes.infer.many.capsule_rows import CapsuleRows
from capsbayes.infer.many.mixture import NUMBERS, mixture
from capsbayes.infer.many.run import Run
from capsbayes.infer.misfit import PREDICTED, Misfit, inertia, misfits_of, p_values
from capsbayes.infer.outline.misfit import outline_misfit
from capsbayes.infer.posterior import REPORTED
from capsbayes.infer.verdict import leanings, leanings_at_nodes, shares_by_kind, verdict
from capsbayes.interruption import raise_interruption
from capsbayes.measurement import Measurement
from capsbayes.measurements.table import NUMBERS as MEASURED
from capsbayes.quantity import Quantity
from capsbayes.status import Status

_SHARED = ("viscosity", "half_width")
_DRAWS = 10_000  # from which the mixture and the shares next to borders are computed where nodes do not tell them


def fill_exactly(rows: CapsuleRows, row: int, measurement: Measurement, run: Run) -> None:
    """Identify one capsule by quadrature and fill its row; one that cannot be identified gets a status and a reason.

    Parameters
    ----------
    rows : CapsuleRows
        Whose arrays are filled.
    row : int
    measurement : Measurement
    run : Run
    """
    rows.engine[row] = "grid"
    try:
        _fill(rows, row, measurement, run)
    except InputError as error:
        rows.refuse(row, Status.NO_SHAPE if isinstance(error, NoShapeError) else Status.UNUSABLE, str(error))
        if isinstance(error, NoShapeError):
            rows.distance[row] = error.distance
    except Exception as error:  # a batch does not stop for one capsule
        raise_interruption(error)
        rows.refuse(row, Status.RAISED, f"{type(error).__name__}: {error}")


def _fill(rows: CapsuleRows, row: int, measurement: Measurement, run: Run) -> None:
    own, seen = run.experiment_of(measurement), measurement.outline
    check_applies(run.model, measurement, own)
    engine = run.engine(own, outline=seen is not None)
    posterior = engine(measurement, inputs=Inputs.of(measurement, own))
    grid = posterior if isinstance(posterior, GridPosterior) and posterior.half_width is None else None
    if grid is None or grid.cut or seen is not None:
        draws = posterior.drawn(np.random.default_rng([run.seed, 1]), _DRAWS)
        leans = leanings(draws, run.model, engine.prior)
    else:
        draws, leans = {}, leanings_at_nodes(grid, engine.prior)
    rows.leaning[row] = shares_by_kind(leans)
    for number, name in enumerate(REPORTED):
        rows.summaries[row, number] = list(vars(posterior.marginal(name)).values())
    if grid is not None and seen is None:
        rows.distance[row] = grid.distance
    found = p_values(engine, measurement, posterior)
    rows.p_values[row] = [found.get(name, np.nan) for name in PREDICTED]
    misfits = misfits_of(found)
    if seen is not None:
        misfits.insert(0, Misfit(outline_misfit(seen, run.model, draws), Status.OUTLINE_MISFIT))
    misfits.append(inertia(float(own.reynolds_number(posterior.marginal("mean_velocity").median))))
    rows.reynolds_number[row] = misfits[-1].gate.value
    rows.status[row] = verdict(posterior.gates, None, leans, misfits, posterior.unresolved).name
    weights, x, y, spread = _likelihood(draws, run, posterior.density.inputs) if grid is None else grid.likelihood
    # a capsule's own viscosity and half width, over those of all, are not among what all share
    of_all = own if run.experiment is None else run.experiment
    shift = [np.log(_centre(own, name) / _centre(of_all, name)) for name in _SHARED]
    into = np.empty(rows.components.shape[1:])
    mixture(weights, x + shift[0], y + shift[1], into)
    into[:, NUMBERS.index("xx")] += spread
    rows.components[row] = into


def _likelihood(draws: Mapping[str, Floats], run: Run, inputs: Inputs) -> tuple[Floats, Floats, Floats, float]:
    """Return that of `GridPosterior.likelihood` at draws: the posterior without the priors of G_s and a."""
    moduli, radii = np.log(draws["surface_shear_modulus"]), np.log(draws["capsule_radius"])
    flat = np.exp(-_log_prior(run.prior.surface_shear_modulus, moduli) - _log_prior(run.prior.capsule_radius, radii))
    if inputs.by_flow_rate:  # U is shared too
        moduli -= np.log(draws["mean_velocity"] * run.model.relative_area(draws) / inputs.mean_velocity(1.0))
    viscosity, half_width = np.log([draws[name] for name in _SHARED])
    return flat, moduli - viscosity, radii - half_width, 0.0


def _log_prior(prior: Quantity, logs: Floats) -> Floats:
    """Return the log density of log x, zero where it is highest; a draw beyond a range counts as within it."""
    density = prior.power * logs if prior.is_range else prior.log_weight(np.exp(logs))
    return density - density.max()


def _centre(experiment: Experiment, name: str) -> float:
    return getattr(experiment, name).mean


def numbers_of(measurement: Measurement) -> Floats:
    """Return the measured numbers as a row of `capsbayes.measurements.table.NUMBERS`, lengths in metres as they are."""
    found = [measurement.conditions.get(name, getattr(measurement, name, None)) for name in MEASURED]
    return np.array([np.nan if number is None else number for number in found], dtype=np.float64)
