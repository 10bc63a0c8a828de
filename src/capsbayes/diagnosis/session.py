"""The capsules of a session as a diagnosis reads them: whitened deviations at places along the flow."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from capsbayes.arrays import Booleans, Floats, Integers
from capsbayes.errors import InputError
from capsbayes.experiment import AREAS, Experiment
from capsbayes.infer.likelihood import length_given_extent
from capsbayes.infer.outline import OutlineLikelihood, outline_likelihood
from capsbayes.least_squares import Linearised, minimise
from capsbayes.measurement import CONDITIONS, MeasuredOutline, Measurement
from capsbayes.measurement_sets import check_comparable, read_set, write_set
from capsbayes.model import ForwardModel
from capsbayes.prediction import Prediction
from capsbayes.quantity import Quantity

if TYPE_CHECKING:
    from capsbayes.infer.population import Population


# Capsules measured in one session: one channel, one liquid, one camera

_BIN = 4  # capsules of like size among which halves are drawn


@dataclass(frozen=True, eq=False)
class Session:
    """Capsules measured under the same conditions, except for the flow rate and the `conditions` of each.

    Parameters
    ----------
    measurements : sequence of Measurement
        Lengths over l; those with an outline are compared by it.
    experiment : Experiment
    left_out : tuple of str
        One line for each capsule that was measured and cannot be used.

    Raises
    ------
    InputError
        If there are no measurements, or one has no result or has lengths in metres.
    """

    measurements: Sequence[Measurement]
    experiment: Experiment
    left_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.measurements:
            raise InputError("session", "measurements", "at least one capsule", "none")
        for number, measurement in enumerate(self.measurements):
            check_comparable(measurement, measurement.source or f"capsule {number}")

    @classmethod
    def read(cls, path: str | Path, experiment: Experiment | str | Path | None = None) -> Session:
        """Read a set of measurements; capsules that cannot be used are in `left_out`.

        Parameters
        ----------
        path : path
            A folder of measurement files as `Measurement.read` reads them, a table of lengths (.csv), or a file of
            outlines (.nc).
        experiment : Experiment or path, optional
            Replaces the one that the set names.

        Raises
        ------
        InputError
            Naming file, key, what was expected and what was found.
        """
        read = read_set(path, experiment)
        return cls(read.measurements, read.experiment, read.left_out)

    @classmethod
    def of(cls, given: Session | Population | str | Path) -> Session:
        """Return a session as it is; read the set of that path, or the one that a population was identified from.

        Raises
        ------
        InputError
            As `read`.
        """
        if isinstance(given, Session):
            return given
        if isinstance(given, (str, Path)):
            return cls.read(given)
        if not hasattr(given, "attributes"):
            expected = "a Session, a Population or a path"
            raise InputError("diagnose", "session", expected, f"one of the type {type(given).__name__}")
        stated = given.attributes["experiment"]
        half_width, viscosity = (Quantity(**stated[name]) for name in CONDITIONS)
        cross_section = stated.get("cross_section") or stated["section"]  # its name up to 0.1.0
        return cls.read(given.attributes["source"], Experiment(cross_section, half_width, viscosity))

    def write(self, path: str | Path) -> None:
        """Write a set that `read` reads.

        Parameters
        ----------
        path : path
            A folder, made if it is missing, for one file a capsule and ``experiment.toml``; or the name of a table of
            lengths (.csv) or of a file of outlines (.nc), which do not hold the experiment.

        Raises
        ------
        InputError
            If the folder holds TOML files already, or a file has no place for what the capsules have.
        """
        write_set(path, self.measurements, self.experiment)

    def __len__(self) -> int:
        return len(self.measurements)

    @cached_property
    def circumstances(self) -> dict[str, Floats]:
        """Conditions of each capsule on which effects may depend : dict of (n,) array, SI."""
        velocity = np.array([measurement.known_velocity.value for measurement in self.measurements])
        known = {"capsule_velocity": velocity}
        for name in CONDITIONS:
            usual = getattr(self.experiment, name).mean
            known[name] = np.array([measurement.conditions.get(name, usual) for measurement in self.measurements])
        if np.isfinite(self.flow_rates).any():
            known["flow_rate"] = self.flow_rates
        return known

    @cached_property
    def flow_rates(self) -> Floats:
        """Flow rates set at the pump : (n,) array [m^3/s], NaN where unknown."""
        return np.array(
            [np.nan if measurement.flow_rate is None else measurement.flow_rate for measurement in self.measurements]
        )

    @property
    def flow_rate_errors(self) -> Floats:
        """Relative standard errors of U = Q/A, by the flow rate and the half width, common to all : (n,) array."""
        rates = np.array([measurement.flow_rate_error or 0.0 for measurement in self.measurements]) / self.flow_rates
        width = self.experiment.half_width
        return np.hypot(rates, 2.0 * width.error / width.mean)

    @property
    def velocity_errors(self) -> Floats:
        """Relative standard errors of the capsules' velocities : (n,) array."""
        return np.array(
            [measurement.capsule_velocity_error / measurement.capsule_velocity for measurement in self.measurements]
        )

    @property
    def order(self) -> Floats:
        """Places of the capsules in the session, from 0 to 1 : (n,) array."""
        return np.linspace(0.0, 1.0, len(self.measurements))

    def mean(self, name: str) -> float:
        """Return the mean of the half width [m] or of the viscosity [Pa s] over the capsules."""
        return float(self.circumstances[name].mean())

    def taken(self, rows: Any) -> Session:
        """Return a session of some of the capsules, given by an array of row numbers."""
        return Session([self.measurements[int(row)] for row in np.asarray(rows)], self.experiment)

    def halves(self, seed: int) -> tuple[Integers, Integers]:
        """Divide the capsules at random into halves of like sizes and velocities, and return their rows."""
        rng = np.random.default_rng(seed)
        extent = np.array([measurement.axial_extent for measurement in self.measurements])
        order = np.lexsort((self.circumstances["capsule_velocity"], np.argsort(np.argsort(extent)) // _BIN))
        first: list[int] = []
        second: list[int] = []
        for start in range(0, len(order), 2):
            pair = rng.permutation(order[start : start + 2])
            first.append(int(pair[0]))
            second.extend(int(row) for row in pair[1:])
        return np.array(sorted(first)), np.array(sorted(second))


# Whitened residuals of measurements: independent numbers of variance one under a right model. The covariance that does
# this is made once, at a pilot, and kept for all models that are compared

_ALL = slice(None)


@dataclass(frozen=True, eq=False)
class OfLengths:
    """Measured lengths (1,) or (2,) and their covariance, the model's own error included."""

    lengths: Floats
    covariance: Floats
    placed: ClassVar[int] = 0  # measured values that determine its place in the picture

    @classmethod
    def of(cls, measurement: Measurement, own: Floats) -> OfLengths:
        """Return the whitener of a measurement, for a model whose own error has the covariance (2, 2)."""
        count = len(measurement.lengths)
        return cls(measurement.lengths, measurement.covariance + own[:count, :count])

    @property
    def count(self) -> int:
        """Number m of residuals."""
        return len(self.lengths)

    def __call__(self, prediction: Prediction, rows: slice = _ALL) -> Floats:
        """Return the whitened differences (k, m) from k predictions, NaN outside the model's domain."""
        lengths = np.stack([prediction.axial_extent[rows], prediction.axial_length[rows]], axis=1)
        away = np.where(prediction.inside[rows, None], self.lengths - lengths[:, : len(self.lengths)], np.nan)
        extent, variance = away[:, 0], self.covariance[0, 0]
        white = [extent / np.sqrt(variance)]
        if len(self.lengths) == 2:
            rest, left = length_given_extent(extent, away[:, 1], variance, *self.covariance[1])
            white.append(rest / np.sqrt(left))
        return np.stack(white, axis=1)


@dataclass(frozen=True, eq=False)
class OfOutline:
    """Measured outline; its likelihood holds the covariance, in which errors shared by all capsules are wider."""

    likelihood: OutlineLikelihood
    measured: MeasuredOutline
    placed: ClassVar[int] = 3  # shifts and tilt

    @property
    def count(self) -> int:
        """Number m of residuals."""
        return len(self.likelihood.points) + (self.likelihood.length is not None)

    def __call__(self, prediction: Prediction, rows: slice = _ALL) -> Floats:
        """Return the whitened differences (k, m) from k predictions, NaN outside the model's domain."""
        assert prediction.outline is not None, "asked for"
        outlines = np.where(prediction.inside[rows, None, None], prediction.outline[rows], np.nan)
        return self.likelihood.whitened(outlines, prediction.axial_length[rows], posed=True)

    def common_errors(self) -> Floats:
        """Return the changes (k, m) of the residuals by errors that all capsules share: the model's and the edge's."""
        return np.concatenate([self.errors_of_model(), self.likelihood.whitened_shared(self.measured)])

    def errors_of_model(self) -> Floats:
        """Return the changes (k, m) of the residuals by the model's own error."""
        seen = self.likelihood
        return np.zeros((0, self.count)) if seen.modes is None else seen.whitened_displacement(seen.modes)


@dataclass(frozen=True, eq=False)
class Whitening:
    """Whitener of each capsule, and the point at which it was made."""

    each: tuple[OfLengths | OfOutline, ...]
    pilots: Floats  # (n, 2): ln Ca and a/l
    outline: bool  # whether any of them reads outlines
    further: float = 0.0  # standard deviation [l] that was added to the noise of each outline

    def outlines(self, wanted: Booleans) -> Iterator[tuple[int, OfOutline]]:
        """Yield row and whitener of the capsules that have an outline, of those that are wanted (n,)."""
        for row in np.flatnonzero(wanted):
            whitener = self.each[row]
            if isinstance(whitener, OfOutline):
                yield int(row), whitener


def whitened_at(
    model: ForwardModel, session: Session, pilots: Floats, *, among: int, further: float = 0.0
) -> Whitening:
    """Make the whitening at pilots (n, 2): ln Ca and a/l of a shape of the model near each capsule."""
    # The errors of the microscope are the same `among` so many capsules. A `further` standard deviation [l] is added to
    # the noise of outlines.
    places = {**session.circumstances, "capillary_number": np.exp(pilots[:, 0]), "size_ratio": pilots[:, 1]}
    own = model(places).covariance[:, :2, :2]
    each: list[OfLengths | OfOutline] = []
    for i, measurement in enumerate(session.measurements):
        if measurement.outline is None:
            each.append(OfLengths.of(measurement, own[i]))
        else:
            place = {name: float(values[i]) for name, values in places.items()}
            seen = measurement.outline.noisier(further).shared_by(among)
            likelihood = outline_likelihood(model, seen, place, length=measurement.length_with_outline)
            each.append(OfOutline(likelihood, measurement.outline))
    outline = any(measurement.outline is not None for measurement in session.measurements)
    return Whitening(tuple(each), pilots, outline, further)


# The flow rate Q is a second source of the mean velocity: U = Q / A without the capsule, its own shape gives v_o/U. The
# logarithm of the measured v_o over the predicted one is zero within the errors under a right model. Those of the
# velocities and of the shapes are independent from capsule to capsule; those of Q, of the half width and of the model
# are common to all

LEAST_SHARED = 1e-4
"""Relative error of a flow rate that is taken as known, so that a common error always has a scale."""


@dataclass(frozen=True, eq=False)
class FlowOffsets:
    """ln of the velocities of n capsules over those that the flow rates and their best shapes give."""

    offset: Floats  # (n,): NaN where no flow rate is known, or the model has no shape
    variance: Floats  # (n,): by the errors of the velocity and of the shape
    with_modulus: Floats  # (n,): covariance with ln G_s
    shared: Floats  # (n,): sd by the errors common to all: of the flow rate, the half width and the model

    @property
    def known(self) -> Booleans:
        """Where there is an offset : (n,) bool array."""
        return np.isfinite(self.offset)

    def log_likelihood(self, log_modulus: Floats, total: Floats, mean: float) -> Floats:
        """Return the log likelihood of each offset given ln G_s, with the likeliest common error : (n,) array."""
        # ln G_s (n,) has the variances `total` (n,) about its mean among the capsules. Zero where there is no offset.
        logs, known = np.zeros(len(self.offset)), self.known
        if not known.any():
            return logs
        slope = self.with_modulus[known] / total[known]
        away = self.offset[known] - slope * (log_modulus[known] - mean)
        variance = self.variance[known] - slope * self.with_modulus[known]
        shared = self.shared[known]
        common = np.sum(away * shared / variance) / (1.0 + np.sum(shared**2 / variance))
        rest = np.square(away - common * shared) / variance + np.log(2.0 * np.pi * variance)
        logs[known] = -0.5 * (rest + common**2 / known.sum())
        return logs


# Best shapes of many capsules at once, from shapes of nearly their lengths: residuals and slopes of a model

LOOSE = np.array([2.0, 1.0])
"""Standard deviations of a loose prior of ln Ca and a/l about the pilots, for what the data leave open."""

_DIFFERENCE = np.array([3e-4, 3e-5])  # of log Ca and a/l, for derivatives
_LONGEST = np.array([0.3, 0.03])  # step
_STEPS = 20  # at most: what is not fitted then lies at the border, or where the misfit has a crease
_GUESSES = (60, 40)  # along log Ca and a/l
_BANDS = 4  # of Ca, in each of which a capsule that is not fitted is tried again


@dataclass(eq=False)
class Places(Linearised):
    """Points in the plane (ln Ca, a/l) of n capsules, with the residuals and slopes of a model there."""

    # The first two residuals are those of the loose prior about the pilots.

    ratio: Floats  # (n,): v_o/U
    ratio_slopes: Floats  # (n, 2)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """Evaluation of a model for some of the capsules; `rest` holds the circumstances of all, and sizes of effects."""

    model: ForwardModel
    white: Whitening
    rest: Mapping[str, Floats]

    def __call__(self, theta: Floats, rows: Integers) -> Places:
        """Evaluate at theta (k, 2) the capsules of k rows."""
        places = self._towards(theta, rows, 1.0)
        edge = np.flatnonzero(places.inside & ~places.differentiable)  # of the domain: look the other way
        if len(edge):
            back = self._towards(theta[edge], rows[edge], -1.0)
            for ahead, behind in ((places.slopes, back.slopes), (places.ratio_slopes, back.ratio_slopes)):
                ahead[edge] = np.where(np.isfinite(ahead[edge]), ahead[edge], behind)
        return places

    def fitted(self, here: Places, rows: Integers) -> Places:
        """Minimise the misfit of capsules, given by their rows, from some places on."""
        return minimise(self, here, rows, _LONGEST, _STEPS)

    def _towards(self, theta: Floats, rows: Integers, sign: float) -> Places:
        """Evaluate with slopes by differences to one side."""
        difference = sign * _DIFFERENCE
        shifts = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]) * difference
        points = (theta[:, None] + shifts).reshape(-1, 2)
        batch = {name: np.repeat(values[rows], len(shifts)) for name, values in self.rest.items()}
        batch |= {"capillary_number": np.exp(points[:, 0]), "size_ratio": points[:, 1]}
        prediction = self.model(batch, outline=self.white.outline)
        ratio = prediction.velocity_ratio.reshape(-1, len(shifts))
        seen = np.zeros((len(rows), len(shifts), 2 + max(white.count for white in self.white.each)))
        seen[:, :, :2] = (theta[:, None] + shifts - self.white.pilots[rows, None]) / LOOSE
        for k, row in enumerate(rows):
            white = self.white.each[row]
            seen[k, :, 2 : 2 + white.count] = white(prediction, slice(len(shifts) * k, len(shifts) * (k + 1)))
        slopes = np.swapaxes(seen[:, 1:] - seen[:, :1], 1, 2) / difference
        return Places(theta, seen[:, 0], slopes, ratio[:, 0], (ratio[:, 1:] - ratio[:, :1]) / difference)


def flow_offsets(session: Session, evaluate: Evaluation, places: Places, covariance: Floats) -> FlowOffsets:
    """Compare the velocities of a session with its flow rates, at the best shapes."""
    # The covariance (n, 2, 2) of ln Ca and a/l is NaN where the model has no shape.
    model, ratio = evaluate.model, places.ratio
    nothing = np.full(len(ratio), np.nan)
    if not np.isfinite(session.flow_rates).any():
        return FlowOffsets(nothing, nothing, nothing, nothing)
    theta = {**evaluate.rest, "capillary_number": np.exp(places.points[:, 0]), "size_ratio": places.points[:, 1]}
    area = AREAS[session.experiment.cross_section] * session.circumstances["half_width"] ** 2
    speed = session.flow_rates / (area * model.relative_area(theta))
    slopes = places.ratio_slopes / ratio[:, None]
    spread = np.einsum("nij,nj->ni", covariance, slopes)
    variance = np.square(session.velocity_errors) + np.sum(slopes * spread, axis=1)
    own = np.sqrt(model(theta).covariance[:, 2, 2]) / ratio
    return FlowOffsets(
        np.where(np.isfinite(variance), np.log(session.circumstances["capsule_velocity"] / (speed * ratio)), np.nan),
        variance,
        variance + spread[:, 0],
        np.sqrt(session.flow_rate_errors**2 + own**2 + LEAST_SHARED**2),
    )


def initial_guesses(
    model: ForwardModel, session: Session, rest: Mapping[str, Floats], rows: Integers, bands: int = _BANDS
) -> Floats:
    """Return ln Ca and a/l (bands, k, 2) of the shapes of nearest lengths in each band of Ca, for k capsules."""
    # `rest` holds the circumstances of all and the sizes of effects.
    (ca_low, ca_high), (size_low, size_high) = model.domain.bounds
    columns = np.linspace(size_low, size_high, _GUESSES[1] + 2)[1:-1]
    ca, size = (axis.ravel() for axis in np.meshgrid(np.geomspace(ca_low, ca_high, _GUESSES[0] + 2)[1:-1], columns))
    band = np.digitize(ca, np.geomspace(ca_low, ca_high, bands + 1)[1:-1])
    guesses = np.empty((bands, len(rows), 2))
    acting = [name for name in rest if name not in session.circumstances or name in model.circumstances]
    predictions: dict[tuple[float, ...], Prediction] = {}
    for k, row in enumerate(rows):
        conditions = tuple(float(rest[name][row]) for name in acting)
        if conditions not in predictions:
            given = {name: np.full(ca.size, value) for name, value in zip(acting, conditions, strict=True)}
            predictions[conditions] = model({**given, "capillary_number": ca, "size_ratio": size})
        prediction = predictions[conditions]
        whitener = OfLengths.of(session.measurements[row], np.zeros((2, 2)))
        away = np.full(ca.size, np.inf)
        away[prediction.inside] = np.sum(np.square(whitener(prediction))[prediction.inside], axis=1)
        for j in range(bands):
            place = int(np.argmin(np.where(band == j, away, np.inf)))
            guesses[j, k] = np.log(ca[place]), size[place]
    return guesses
