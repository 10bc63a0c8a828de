"""Sobol indices of the paper's deterministic answer: which input, varied over its range, moves it how much.

Sobol's estimators compare answers in groups of samples that share all inputs
but one, so that no sample may be missing. Those with a shape that no capsule
of the database has are therefore answered too, by the nearest shape that one
has. Beside these indices stands how much they change if all groups that hold
such a sample are left out, which is wrong in another way: the inputs that
remain are no longer independent.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment, Given
from capsbayes.infer.inputs import Inputs
from capsbayes.measurement import Measurement
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS, STATED
from capsbayes.plan.answers import ANSWERS, Answerer
from capsbayes.plan.slopes import settings_of
from capsbayes.plan.sobol_study import CONFIDENCE, SobolIndex, SobolStudy
from capsbayes.quantity import Quantity
from capsbayes.status import Status

__all__ = ["SAMPLES", "sobol_indices", "varied_range"]

Floats = NDArray[np.float64]

SAMPLES = 1024
"""Groups of samples; each takes as many answers as inputs vary, and two."""

_VARIED = ("viscosity", "half_width", "capsule_velocity", "axial_extent", "axial_length")
_MOST_OUTSIDE = 0.1  # of the samples, beyond which the indices are those of the border of the database


def sobol_indices(
    measurement: Measurement,
    model: ForwardModel,
    experiment: Experiment,
    *,
    seed: int,
    ranges: Mapping[str, Given] | None = None,
    samples: int = SAMPLES,
) -> SobolStudy:
    """Sobol indices of the deterministic answer over ranges of the inputs.

    Parameters
    ----------
    measurement : Measurement
        Both lengths and the velocity.
    model : ForwardModel
        With a database.
    experiment : Experiment
    seed : int
        Of the samples; stored in the result.
    ranges : mapping, optional
        By input, in any form that `varied_range` reads; an input that is not stated varies by its standard error, if it
        has one.
    samples : int
        Groups of samples, a power of two.

    Returns
    -------
    SobolStudy

    Raises
    ------
    InputError
        If there is no deterministic answer, or an argument cannot be used.

    References
    ----------
    Saltelli et al., Computer Physics Communications 181 (2010) 259, doi:10.1016/j.cpc.2009.09.018.
    """
    _check(measurement, samples)
    inputs = Inputs.of(measurement, experiment)
    varied = _ranges(measurement, inputs, ranges or {})
    answerer = Answerer.of(model, measurement, inputs, {name: one.error for name, one in varied.items()})
    problem = _problem(varied)
    rows = _sampled(problem, samples, seed)
    values, outside = answerer(dict(zip(varied, rows.T, strict=True)))
    indices = {name: _analysed(problem, values[name], seed) for name in ANSWERS}
    share = float(np.mean(outside))
    return SobolStudy(
        ranges=varied,
        indices=indices,
        mean={name: float(values[name].mean()) for name in ANSWERS},
        sd={name: float(values[name].std()) for name in ANSWERS},
        samples=len(rows),
        outside=int(np.count_nonzero(outside)),
        change=_change(problem, values, outside, indices, seed),
        groups=samples,
        seed=seed,
        notes=_notes(measurement),
        model_name=model.name,
        model_sha256=model.sha256,
        status=Status.DONE if share <= _MOST_OUTSIDE else Status.RANGES_LEAVE_DATABASE,
    )


def _check(measurement: Measurement, samples: int) -> None:
    where = measurement.source or "measurement"
    if measurement.axial_length is None:
        raise InputError(where, "axial_length", "both lengths, as the paper's procedure needs", "L_z alone")
    if samples < 8 or samples & (samples - 1):
        raise InputError("sobol", "samples", "a power of two, at least 8", str(samples))


def varied_range(given: Given, name: str, *, where: str = "ranges") -> Quantity:
    """Return the range over which an input varies.

    Parameters
    ----------
    given
        ``"0.80 .. 0.90 Pa s"`` or ``"0.85 +/- 0.02 Pa s"``, or whatever else `Quantity.of` reads; lengths over the half
        width or in metres.
    name : str
        Of the input, as in `capsbayes.parameters`.
    where : str
        For the message of an error.

    Raises
    ------
    InputError
        If it is not a range of such an input, or so wide that a normal distribution reaches zero.

    Examples
    --------
    >>> varied_range("0.80 .. 0.90 Pa s", "viscosity").low
    0.8
    """
    if name not in _VARIED:
        raise InputError(where, name, f"one of {', '.join(_VARIED)}", "an unknown input")
    units = ("", "m") if name.startswith("axial") else (PARAMETERS[name].si,)
    found = Quantity.of(given, name, where=where, units=units)
    if found.known:
        raise InputError(where, name, f'a range like "{STATED[name].example}" or "low .. high"', repr(given))
    if found.shape not in ("uniform", "normal") or (found.shape == "normal" and found.value <= 4.0 * found.error):
        expected = 'a range "low .. high", or a standard error below a quarter of the value'
        raise InputError(where, name, expected, str(found))
    return found


def _ranges(measurement: Measurement, inputs: Inputs, stated: Mapping[str, Given]) -> dict[str, Quantity]:
    """Return every input that varies, with its range."""
    known = settings_of(replace(measurement, outline=None), inputs)
    for name in stated:
        if name not in known:
            raise InputError("ranges", name, f"one of {', '.join(known)}", "an unknown input")
    own = {name: Quantity(one.value, one.error) for name, one in known.items() if one.error > 0.0}
    ranges = own | {name: varied_range(one, name) for name, one in stated.items()}
    varied = {name: ranges[name] for name in known if name in ranges}
    if len(varied) < 2:
        raise InputError("ranges", "", "at least two inputs that vary", ", ".join(varied) or "none")
    return varied


def _notes(measurement: Measurement) -> tuple[str, ...]:
    notes = []
    if measurement.length_correlation:
        notes.append("The errors of L_z and L_a are correlated; the indices take all inputs as independent.")
    if measurement.outline is not None:
        notes.append("The indices are those of the lengths: the paper's procedure does not read the outline.")
    return tuple(notes)


def _problem(varied: Mapping[str, Quantity]) -> dict[str, Any]:
    return {
        "num_vars": len(varied),
        "names": list(varied),
        "bounds": [list(one.parameters) for one in varied.values()],
        "dists": [{"uniform": "unif", "normal": "norm"}[one.shape] for one in varied.values()],
    }


def _sampled(problem: dict[str, Any], samples: int, seed: int) -> Floats:
    from SALib.sample import sobol

    return np.asarray(sobol.sample(problem, samples, calc_second_order=False, seed=seed))


def _analysed(problem: dict[str, Any], values: Floats, seed: int) -> dict[str, SobolIndex]:
    """Indices of one answer; zero of one that does not vary."""
    from SALib.analyze import sobol

    if np.ptp(values) <= 1e-12 * np.abs(values).max():
        return {name: SobolIndex(0.0, 0.0, 0.0, 0.0) for name in problem["names"]}
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Constant values encountered")  # resampled within a group
        found = sobol.analyze(problem, values, calc_second_order=False, conf_level=CONFIDENCE, seed=seed + 1)
    columns = zip(*(found[key] for key in ("S1", "S1_conf", "ST", "ST_conf")), strict=True)
    return {name: SobolIndex(*map(float, one)) for name, one in zip(problem["names"], columns, strict=True)}


def _change(
    problem: dict[str, Any],
    values: Mapping[str, Floats],
    outside: NDArray[np.bool_],
    indices: Mapping[str, Mapping[str, SobolIndex]],
    seed: int,
) -> float:
    """Largest change of an index of G_s or a without the groups that hold a sample outside."""
    if not outside.any():
        return 0.0
    size = problem["num_vars"] + 2
    kept = np.repeat(~outside.reshape(-1, size).any(axis=1), size)
    if np.count_nonzero(kept) < 8 * size:
        return float("nan")
    changes = []
    for answer in ("surface_shear_modulus", "capsule_radius"):
        fewer = _analysed(problem, values[answer][kept], seed)
        for name, one in indices[answer].items():
            changes += [abs(fewer[name].first - one.first), abs(fewer[name].total - one.total)]
    return max(changes)
