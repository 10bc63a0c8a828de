"""The errors of a laboratory's inputs, and the range of the model at them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.measurement import MID_PLANE, MeasuredOutline, Measurement, OutlineNoise
from capsbayes.model import ForwardModel
from capsbayes.quantity import Given, Quantity

# Measuring errors of a lab, and the measurement that a given shape would lead to

_SURE = 1e-6  # relative error of a flow rate that is stated without one


@dataclass(frozen=True)
class LabErrors:
    """Standard errors of the lengths and of the velocity; those of viscosity and half width are the experiment's.

    Parameters
    ----------
    axial_extent : float [l or m]
        Of L_z. This and the next three may be texts or quantities of pint; a length with a unit is in metres.
    capsule_velocity : float [-]
        Relative standard error of v_o.
    axial_length : float or None [l or m]
        Of L_a; None where the rear is not seen.
    length_correlation : float
        Between the errors of the two lengths.
    over_half_width : bool
        True for lengths over l, False for lengths in metres.
    outline : OutlineNoise, optional
        Errors of the outlines, if outlines are measured.
    view : str
        View of the outlines, ``"mid-plane"`` or ``"silhouette"``.
    flow_rate : float, optional [-]
        Relative standard error of the flow rate of the pump, if the flow rate is known.

    Raises
    ------
    InputError
        If an error is not positive and finite.

    Examples
    --------
    >>> LabErrors(axial_extent=0.02, axial_length=0.02, capsule_velocity=0.01).covariance.round(6).tolist()
    [[0.0004, 0.0], [0.0, 0.0004]]
    """

    axial_extent: Given
    capsule_velocity: Given
    axial_length: Given | None
    length_correlation: float = 0.0
    over_half_width: bool = True
    outline: OutlineNoise | None = None
    view: str = MID_PLANE
    flow_rate: Given | None = None

    def __post_init__(self) -> None:
        self._read_units()
        optional = ("axial_length", "flow_rate")
        for name in ("axial_extent", "capsule_velocity", *optional):
            error = getattr(self, name)
            if not (name in optional and error is None) and not (np.isfinite(error) and error > 0.0):
                raise InputError("errors", name, "a positive finite standard error", repr(error))
        if not -1.0 < self.length_correlation < 1.0:
            raise InputError("errors", "length_correlation", "between -1 and 1", repr(self.length_correlation))

    def _read_units(self) -> None:
        """Turn texts and quantities of pint into numbers; a length in a unit says that lengths are in metres."""
        lengths = ("axial_extent", "axial_length")
        for name in (*lengths, "capsule_velocity", "flow_rate"):
            given = getattr(self, name)
            if given is None or isinstance(given, (int, float, np.floating, np.integer)):
                continue
            read = Quantity.of(given, where="errors", key=name, units=("", "m") if name in lengths else ("",))
            if name == "axial_extent":
                object.__setattr__(self, "over_half_width", not read.unit)
            if name == "axial_length" and bool(read.unit) == self.over_half_width:
                raise InputError("errors", name, "lengths both over l or both in metres", str(given))
            object.__setattr__(self, name, read.value)

    @classmethod
    def of(cls, measurement: Measurement) -> LabErrors:
        """Return the errors of a measured capsule."""
        relative = measurement.known_velocity.error / measurement.known_velocity.value
        outline, rate = measurement.outline, measurement.flow_rate
        return cls(
            measurement.axial_extent_error,
            relative,
            measurement.axial_length_error,
            measurement.length_correlation,
            measurement.over_half_width,
            None if outline is None else outline.noise,
            MID_PLANE if outline is None else outline.view,
            None if not rate else max((measurement.flow_rate_error or 0.0) / rate, _SURE),
        )

    @property
    def covariance(self) -> Floats:
        """Covariance of the measured lengths, L_z or (L_z, L_a) : (k, k) array."""
        if self.axial_length is None:
            return np.array([[self.axial_extent**2]])
        cross = self.length_correlation * self.axial_extent * self.axial_length
        return np.array([[self.axial_extent**2, cross], [cross, self.axial_length**2]])

    def measured(
        self,
        lengths: Floats,
        capsule_velocity: float,
        outline: Floats | None = None,
        flow_rate: float | None = None,
    ) -> Measurement:
        """Return a measurement of given lengths, and of an outline and a flow rate if these are given.

        Parameters
        ----------
        lengths : (2,) array [l or m]
            L_z and L_a; L_a is limited to L_z where noise makes it longer.
        capsule_velocity : float [m/s]
        outline : (m, 2) array, optional [l]
        flow_rate : float, optional [m^3/s]
            Ignored if no error of the flow rate is stated.
        """
        extent = float(lengths[0])
        noise = None if outline is None else self.outline
        rate = flow_rate if self.flow_rate is not None else None
        return Measurement(
            axial_extent=extent,
            axial_extent_error=self.axial_extent,
            capsule_velocity=capsule_velocity,
            capsule_velocity_error=self.capsule_velocity * capsule_velocity,
            axial_length=None if self.axial_length is None else min(float(lengths[1]), extent),
            axial_length_error=self.axial_length,
            length_correlation=self.length_correlation,
            over_half_width=self.over_half_width,
            outline=None if outline is None or noise is None else MeasuredOutline(outline, noise, view=self.view),
            flow_rate=rate,
            flow_rate_error=None if rate is None or self.flow_rate is None else self.flow_rate * rate,
        )

    def as_dict(self) -> dict[str, float | str | None]:
        """Return the fields with their unit, for files."""
        unit = "l" if self.over_half_width else "m"
        found: dict[str, float | str | None] = {
            "axial_extent": self.axial_extent,
            "axial_length": self.axial_length,
            "unit_of_lengths": unit,
            "length_correlation": self.length_correlation,
            "capsule_velocity_relative": self.capsule_velocity,
        }
        if self.outline is not None:
            found |= {"outline": self.outline.scale, "outline_correlation": self.outline.correlation_length}
        return found if self.flow_rate is None else found | {"flow_rate_relative": self.flow_rate}


def root_of(covariance: Floats) -> Floats:
    """Return the lower triangular root of a covariance (k, k), which may be singular."""
    # Eigenvectors and singular vectors would do, but their signs depend on the processor.
    ridge = 1e-14 * np.diag(covariance).max() + np.finfo(np.float64).tiny
    return np.asarray(np.linalg.cholesky(covariance + ridge * np.eye(len(covariance))))


# Range of capillary numbers in which a model has shapes of one size

_SCANNED = 4001


@dataclass(frozen=True)
class CaRange:
    """Range of Ca at one a/l."""

    size_ratio: float
    lowest: float  # end of the model; NaN where it has no shape of this size
    highest: float
    limit: bool  # whether no steady shape is known above the highest, rather than none computed

    @property
    def empty(self) -> bool:
        """True if the model has no shape of this size."""
        return not np.isfinite(self.highest)

    def inner(self, count: int) -> Floats:
        """Return points in equal ratios from end to end, a thousandth within them : (count,) array."""
        return np.geomspace(1.001 * self.lowest, 0.999 * self.highest, count)


def range_at(model: ForwardModel, size_ratio: float) -> CaRange:
    """Return the range of Ca of a model at one a/l."""
    low, high = model.domain.bounds[0]
    ca = np.geomspace(low, high, _SCANNED)
    within = np.flatnonzero(model.domain.contains(ca, np.full(_SCANNED, size_ratio)))
    if not within.size:
        return CaRange(size_ratio, np.nan, np.nan, False)
    highest = float(ca[within[-1]])
    return CaRange(size_ratio, float(ca[within[0]]), highest, model.domain.is_limit_of_existence(size_ratio))


@dataclass(frozen=True, eq=False)
class Borders:
    """Range of Ca of a model over a/l, to be read at many capsules."""

    sizes: Floats  # (b,): a/l, rising
    lowest: Floats  # (b,): end of the model there
    highest: Floats

    @classmethod
    def of(cls, model: ForwardModel, sizes: Floats) -> Borders:
        """Return those of a model at sizes (b,) that it has."""
        ranges = [range_at(model, float(size)) for size in sizes]
        return cls(sizes, *(np.array([getattr(one, end) for one in ranges]) for end in ("lowest", "highest")))

    def at(self, size: Floats) -> tuple[Floats, Floats]:
        """Return the lowest and the highest Ca at sizes : (n,) arrays."""
        return np.interp(size, self.sizes, self.lowest), np.interp(size, self.sizes, self.highest)
