"""Sobol indices of the inputs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import KDTree
from scipy.stats import norm, qmc

from capsbayes import __version__
from capsbayes.arguments import checked
from capsbayes.arrays import Booleans, Floats
from capsbayes.errors import InputError
from capsbayes.experiment import Experiment, capsule_radius, mean_velocity, surface_shear_modulus
from capsbayes.infer.prior import Inputs
from capsbayes.measurement import Measurement
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS, STATED
from capsbayes.plan.lab import settings_of
from capsbayes.quantity import Given, Quantity
from capsbayes.readable import Readable
from capsbayes.status import Status

if TYPE_CHECKING:
    import pandas as pd


CONFIDENCE = 0.95

ANSWERS = ("surface_shear_modulus", "capsule_radius", "capillary_number", "size_ratio")
"""Quantities answered, as in `capsbayes.parameters`."""


@dataclass(frozen=True)
class SobolIndex:
    """Indices of one input, each with half of its 95 % confidence interval."""

    first: float  # share of the variance owed to this input alone
    first_error: float
    total: float  # owed to it alone or together with others
    total_error: float


@dataclass(frozen=True, eq=False, repr=False)
class SobolStudy(Readable):
    """First-order and total indices of each answer by each input."""

    ranges: Mapping[str, Quantity]  # over which each input was varied
    indices: Mapping[str, Mapping[str, SobolIndex]]  # by answer (G_s, a, Ca, a/l), then by input
    mean: Mapping[str, float]  # of each answer over the ranges [SI]
    sd: Mapping[str, float]
    samples: int  # number of answers
    outside: int  # how many of them had no exact shape and used the nearest
    change: float  # largest change of an index of G_s or a without groups with such a sample; NaN if too few are left
    groups: int
    seed: int
    notes: tuple[str, ...]
    model_name: str
    model_sha256: str
    status: Status

    def described(self) -> dict[str, str]:
        """Return the total index of each input for G_s."""
        return {name: f"{index.total:.2f}" for name, index in self.indices[ANSWERS[0]].items()}

    def table(self, answer: str = "surface_shear_modulus") -> pd.DataFrame:
        """Return the indices of one answer, a row for each input."""
        import pandas as pd

        rows = {name: asdict(index) for name, index in self.indices[answer].items()}
        return pd.DataFrame.from_dict(rows, orient="index")

    def as_dict(self) -> dict[str, Any]:
        """Return all fields, ready for JSON."""
        return {
            "status": self.status.name,
            "sentence": str(self.status),
            "ranges": {
                name: {"kind": quantity.shape, **dict(zip(("first", "second"), quantity.parameters, strict=True))}
                for name, quantity in self.ranges.items()
            },
            "indices": {
                answer: {name: asdict(index) for name, index in found.items()} for answer, found in self.indices.items()
            },
            "mean": {name: {"value": value, "unit": PARAMETERS[name].unit} for name, value in self.mean.items()},
            "sd": {name: {"value": value, "unit": PARAMETERS[name].unit} for name, value in self.sd.items()},
            "samples": self.samples,
            "outside": self.outside,
            "largest_change_without_them": None if np.isnan(self.change) else self.change,
            "groups": self.groups,
            "confidence": CONFIDENCE,
            "notes": list(self.notes),
            "model": {"name": self.model_name, "sha256": self.model_sha256},
            "seed": self.seed,
            "version": __version__,
        }


# The estimators compare answers in groups of samples that share all inputs but one, so that no sample may be missing.
# Lengths that belong to no capsule of the database therefore get the answer of the nearest shape that does. The study
# also gives the change of the indices when all groups with such a sample are omitted; those are biased too, since the
# inputs that remain are no longer independent

SAMPLES = 1024
"""Groups of samples; each takes as many answers as inputs vary, and two."""

_VARIED = ("viscosity", "half_width", "capsule_velocity", "flow_rate", "axial_extent", "axial_length")
_RESAMPLED = 200  # times, for the errors of the indices
_FEWEST_KEPT = 8  # groups, with which indices are compared
_MOST_OUTSIDE = 0.1  # of the samples, beyond which the indices are those of the border of the database


@checked
def sobol_indices(
    measurement: Measurement,
    model: ForwardModel,
    experiment: Experiment,
    *,
    seed: int,
    ranges: Mapping[str, Given] | None = None,
    samples: int = SAMPLES,
) -> SobolStudy:
    """Estimate the Sobol indices of the deterministic answer over ranges of the inputs.

    Parameters
    ----------
    measurement : Measurement
        Both lengths, and the velocity or the flow rate.
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
    if measurement.axial_length is None:
        expected = "both lengths, as the paper's procedure needs"
        raise InputError(measurement.source or "measurement", "axial_length", expected, "L_z alone")
    if samples < 8 or samples & (samples - 1):
        raise InputError("sobol", "samples", "a power of two, at least 8", str(samples))
    model.check_experiment(experiment)
    inputs = Inputs.of(measurement, experiment)
    varied = _ranges(measurement, inputs, ranges or {})
    answerer = Answerer(model, measurement, inputs, {name: quantity.error for name, quantity in varied.items()})
    rows = _sampled(varied, samples, seed)
    answers, outside = answerer(dict(zip(varied, rows.reshape(-1, len(varied)).T, strict=True)))
    values = {name: answer.reshape(samples, -1) for name, answer in answers.items()}
    outside = outside.reshape(samples, -1)
    return SobolStudy(
        ranges=varied,
        indices={name: _indices(varied, values[name], seed + 1) for name in ANSWERS},
        mean={name: float(values[name].mean()) for name in ANSWERS},
        sd={name: float(values[name].std()) for name in ANSWERS},
        samples=outside.size,
        outside=int(np.count_nonzero(outside)),
        change=_change(values, outside),
        groups=samples,
        seed=seed,
        notes=_notes(measurement),
        model_name=model.name,
        model_sha256=model.sha256,
        status=Status.DONE if outside.mean() <= _MOST_OUTSIDE else Status.RANGES_LEAVE_DATABASE,
    )


def varied_range(given: Given, name: str, *, where: str = "ranges") -> Quantity:
    """Return the range over which an input varies, given in any form that `Quantity.of` reads.

    >>> varied_range("0.80 .. 0.90 Pa s", "viscosity").low
    0.8
    """
    # Refused if it is so wide that a normal distribution reaches zero; `where` is for the message.
    if name not in _VARIED:
        raise InputError(where, name, f"one of {', '.join(_VARIED)}", "an unknown input")
    units = ("", "m") if name.startswith("axial") else (PARAMETERS[name].si,)
    quantity = Quantity.of(given, name, where=where, units=units)
    if quantity.known:
        raise InputError(where, name, f'a range like "{STATED[name].example}" or "low .. high"', repr(given))
    normal = quantity.shape == "normal"
    if not (normal or quantity.shape == "uniform") or (normal and quantity.value <= 4.0 * quantity.error):
        expected = 'a range "low .. high", or a standard error below a quarter of the value'
        raise InputError(where, name, expected, str(quantity))
    return quantity


def _ranges(measurement: Measurement, inputs: Inputs, stated: Mapping[str, Given]) -> dict[str, Quantity]:
    """Return every input that varies, with its range."""
    known = settings_of(replace(measurement, outline=None), inputs)
    for name in stated:
        if name not in known:
            raise InputError("ranges", name, f"one of {', '.join(known)}", "an unknown input")
    uncertain = {name: given for name, given in known.items() if not given.known}
    ranges = uncertain | {name: varied_range(given, name) for name, given in stated.items()}
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


def _sampled(varied: Mapping[str, Quantity], groups: int, seed: int) -> Floats:
    """Return samples (groups, 2 + k, k) of k inputs: A, B, and A with one of its inputs taken from B."""
    count = len(varied)
    shares = qmc.Sobol(2 * count, rng=seed).random(groups)
    first, second = shares[:, :count], shares[:, count:]
    rows = np.repeat(first[:, None], 2 + count, axis=1)
    rows[:, 1] = second
    rows[:, 2 + np.arange(count), np.arange(count)] = second
    return np.stack([quantity.ppf(rows[..., column]) for column, quantity in enumerate(varied.values())], axis=-1)


def _estimated(values: Floats) -> Floats:
    """Return first-order and total indices (2, k) of an answer (groups, 2 + k)."""
    # Saltelli et al. (2010), table 2, (b) and (f). `scipy.stats.sobol_indices` takes a power of two of groups only, and
    # its bootstrap takes no seed.
    centred = values - values[:, :2].mean()
    first, second, mixed = centred[:, :1], centred[:, 1:2], centred[:, 2:]
    alone = np.mean(second * (mixed - first), axis=0)
    total = 0.5 * np.mean((first - mixed) ** 2, axis=0)
    return np.asarray(np.stack([alone, total]) / values[:, :2].var())


def _indices(varied: Mapping[str, Quantity], values: Floats, seed: int) -> dict[str, SobolIndex]:
    """Return the indices of one answer (groups, 2 + k), zero if it does not vary."""
    if np.ptp(values) <= 1e-12 * np.abs(values).max():
        return {name: SobolIndex(0.0, 0.0, 0.0, 0.0) for name in varied}
    rng = np.random.default_rng(seed)
    resampled = [_estimated(values[rng.integers(len(values), size=len(values))]) for _ in range(_RESAMPLED)]
    error = norm.isf(0.5 * (1.0 - CONFIDENCE)) * np.std(resampled, axis=0)
    columns = np.stack([_estimated(values), error], axis=1).reshape(4, -1).T
    return {name: SobolIndex(*map(float, row)) for name, row in zip(varied, columns, strict=True)}


def _change(values: Mapping[str, Floats], outside: Booleans) -> float:
    """Return the largest change of an index of G_s or a when the groups that hold a sample outside are omitted."""
    kept = ~outside.any(axis=1)
    if kept.all():
        return 0.0
    if np.count_nonzero(kept) < _FEWEST_KEPT:
        return float("nan")
    both = (values[answer] for answer in ("surface_shear_modulus", "capsule_radius"))
    return max(float(np.abs(_estimated(samples[kept]) - _estimated(samples)).max()) for samples in both)


# The paper's deterministic answer for many samples of the inputs, with the nearest shape where there is none

_LATTICE = (400, 240)  # of the shapes among which the nearest is sought, along log Ca and a/l


class Answerer:
    """Deterministic answer as a function of all inputs, by a model with a database of (Ca, a/l)."""

    def __init__(self, model: ForwardModel, measurement: Measurement, inputs: Inputs, sds: Mapping[str, float]) -> None:
        if model.database is None or model.coordinates:
            raise InputError("sobol", "model", "a database of (Ca, a/l), as the paper's procedure needs", model.name)
        self.model, self.database, self.inputs = model, model.database, inputs
        self.over_half_width = measurement.over_half_width
        speed = "flow_rate" if inputs.by_flow_rate else "capsule_velocity"
        known = {name: getattr(inputs, name).value for name in ("viscosity", "half_width", speed)}
        lengths = {name: float(getattr(measurement, name)) for name in ("axial_extent", "axial_length")}
        self.centre = known | lengths  # values of the inputs that a sample does not state
        scale = 1.0 if self.over_half_width else known["half_width"]
        relative = 0.0 if self.over_half_width else sds.get("half_width", 0.0) / known["half_width"]
        own = [np.hypot(sds.get(name, 0.0), relative * length) / scale for name, length in lengths.items()]
        self._scales = np.maximum(own, 0.1 * max(*own, 1e-6))  # of the lengths: over these, shapes are near or far

    def __call__(self, samples: Mapping[str, Floats]) -> tuple[dict[str, Floats], Booleans]:
        """Return the answers by name [SI] to all samples (n,), and whether each is that of the nearest shape."""
        count = len(next(iter(samples.values())))
        all_inputs = {name: samples.get(name, np.full(count, value)) for name, value in self.centre.items()}
        scale = 1.0 if self.over_half_width else all_inputs["half_width"]
        lengths = np.stack([all_inputs["axial_extent"], all_inputs["axial_length"]], axis=1)
        lengths = lengths / np.reshape(scale, (-1, 1))
        unique, which = np.unique(lengths, axis=0, return_inverse=True)
        places, outside = self._places(unique)
        ca, size, ratio = places[which.ravel()].T
        if self.inputs.by_flow_rate:
            flow = all_inputs["flow_rate"] / (self.inputs.area * all_inputs["half_width"] ** 2)
        else:
            flow = mean_velocity(capsule_velocity=all_inputs["capsule_velocity"], velocity_ratio=ratio)
        modulus = surface_shear_modulus(viscosity=all_inputs["viscosity"], mean_velocity=flow, capillary_number=ca)
        radius = capsule_radius(size_ratio=size, half_width=all_inputs["half_width"])
        return dict(zip(ANSWERS, (modulus, radius, ca, size), strict=True)), outside[which.ravel()]

    def _places(self, lengths: Floats) -> tuple[Floats, Booleans]:
        """Return Ca, a/l and v_o/U (n, 3) of lengths (n, 2), and a mask of the answers of the nearest shape."""
        from capsbayes.surrogate import inverse

        procedure = inverse(self.database)
        places = np.full((len(lengths), 3), np.nan)
        for row in np.flatnonzero((lengths[:, 1] > 0.0) & (lengths[:, 1] <= lengths[:, 0])):
            shape = procedure(axial_extent=float(lengths[row, 0]), axial_length=float(lengths[row, 1]))
            places[row] = shape.capillary_number, shape.size_ratio, shape.velocity_ratio
        outside = ~self.model.domain.contains(places[:, 0], places[:, 1])
        if outside.any():
            places[outside] = self._nearest(lengths[outside])
        return places, outside

    def _nearest(self, lengths: Floats) -> Floats:
        """Return Ca, a/l and v_o/U (n, 3) of the shapes of a lattice over the domain that are nearest to lengths."""
        (ca_low, ca_high), (size_low, size_high) = self.model.domain.bounds
        ca, size = np.geomspace(ca_low, ca_high, _LATTICE[0]), np.linspace(size_low, size_high, _LATTICE[1])
        ca, size = np.repeat(ca, len(size)), np.tile(size, len(ca))
        shapes = self.model({"capillary_number": ca, "size_ratio": size})
        places = np.stack([ca, size, shapes.velocity_ratio], axis=1)[shapes.inside]
        tree = KDTree(shapes.values[shapes.inside, :2] / self._scales)
        return places[np.asarray(tree.query(lengths / self._scales)[1])]
