"""Row of one capsule by the exact engine: outlines, lengths in metres, models with a further coordinate."""

from __future__ import annotations

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes.arrays import Floats
from capsbayes.errors import InputError, NoShapeError
from capsbayes.experiment import Experiment
from capsbayes.infer.exact import exact_engine
from capsbayes.infer.identify import check_applies
from capsbayes.infer.many.capsule_rows import CapsuleRows
from capsbayes.infer.many.run import Run
from capsbayes.infer.many.tabulated.mixture import mixture
from capsbayes.infer.many.tabulated.row_kernel import QUANTITIES
from capsbayes.infer.misfit import PREDICTED, Misfit, inertia, misfits_of, p_values
from capsbayes.infer.outline.misfit import outline_misfit
from capsbayes.infer.verdict import leanings, shares_by_kind, verdict
from capsbayes.interruption import raise_interruption
from capsbayes.measurement import Measurement
from capsbayes.measurements.table import NUMBERS
from capsbayes.quantity import Quantity
from capsbayes.status import Status

_SHARED = ("viscosity", "half_width")
_DRAWS = 10_000  # from which the mixture and the shares next to borders are computed


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
    except Exception as error:  # a batch does not stop for one capsule
        raise_interruption(error)
        rows.refuse(row, Status.RAISED, f"{type(error).__name__}: {error}")


def _fill(rows: CapsuleRows, row: int, measurement: Measurement, run: Run) -> None:
    own = run.experiment_of(measurement)
    check_applies(run.model, measurement, own)
    with threadpool_limits(limits=1):
        engine = exact_engine(run.model, own, run.prior, outline=measurement.outline is not None)
        posterior = engine(measurement)
    draws = posterior.drawn(np.random.default_rng([run.seed, 1]), _DRAWS)
    for number, name in enumerate(QUANTITIES):
        rows.summaries[row, number] = list(posterior.marginal(name).as_dict().values())
    leans = leanings(draws, run.model, engine.prior)
    rows.leaning[row] = shares_by_kind(leans)
    found = p_values(engine, measurement, posterior)
    rows.p_values[row] = [found.get(name, np.nan) for name in PREDICTED]
    misfits = misfits_of(found)
    if measurement.outline is not None:
        misfits.insert(0, Misfit(outline_misfit(measurement.outline, run.model, draws), Status.OUTLINE_MISFIT))
    misfits.append(inertia(float(own.reynolds_number(posterior.marginal("mean_velocity").median))))
    rows.reynolds_number[row] = misfits[-1].gate.value
    rows.status[row] = verdict(posterior.gates, None, leans, misfits, posterior.unresolved).name
    # the likelihood: the posterior without the priors of G_s and a
    moduli, radii = np.log(draws["surface_shear_modulus"]), np.log(draws["capsule_radius"])
    flat = np.exp(-_log_prior(run.prior.surface_shear_modulus, moduli) - _log_prior(run.prior.capsule_radius, radii))
    into = np.empty(rows.components.shape[1:])
    logs = np.log([draws[name] for name in _SHARED])
    if (inputs := posterior.density.inputs).by_flow_rate:  # U is shared too
        flow = draws["mean_velocity"] * run.model.relative_area(draws) / inputs.mean_velocity(1.0)
        moduli = moduli - np.log(flow)
    # a capsule's own viscosity and half width, over those of all, are not among what all share
    of_all = own if run.experiment is None else run.experiment
    shift = [np.log(_centre(own, name) / _centre(of_all, name)) for name in _SHARED]
    mixture(flat, moduli - logs[0] + shift[0], radii - logs[1] + shift[1], into)
    rows.components[row] = into


def _log_prior(prior: Quantity, logs: Floats) -> Floats:
    """Return the log density of log x, zero where it is highest; a draw beyond a range counts as within it."""
    density = prior.power * logs if prior.is_range else prior.log_weight(np.exp(logs))
    return density - density.max()


def _centre(experiment: Experiment, name: str) -> float:
    return getattr(experiment, name).mean


def numbers_of(measurement: Measurement) -> Floats:
    """Return the measured numbers as a row of `NUMBERS`, lengths in metres as they are."""
    found = [measurement.conditions.get(name, getattr(measurement, name, None)) for name in NUMBERS]
    return np.array([np.nan if number is None else number for number in found], dtype=np.float64)
