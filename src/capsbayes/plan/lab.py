"""The errors of a laboratory, the capsules that it expects, and the range of Ca of a model for them."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np

from capsbayes import __version__
from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.experiment import AREAS, Experiment, capillary_number, size_ratio
from capsbayes.infer.log_grid import LogGrid
from capsbayes.infer.prior import Inputs
from capsbayes.measurement import CONDITIONS, MID_PLANE, MeasuredOutline, Measurement, OutlineNoise
from capsbayes.model import ForwardModel
from capsbayes.parameters import PARAMETERS
from capsbayes.quantity import Given, Quantity, settle

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
                settle(self, over_half_width=not read.unit)
            if name == "axial_length" and bool(read.unit) == self.over_half_width:
                raise InputError("errors", name, "lengths both over l or both in metres", str(given))
            settle(self, **{name: read.value})

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
            measurement.view,
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
        self, lengths: Floats, capsule_velocity: float, outline: Floats | None = None, flow_rate: float | None = None
    ) -> Measurement:
        """Return a measurement of lengths L_z and L_a (2,) [l or m], and of an outline (m, 2) [l] if it is given."""
        # L_a is limited to L_z where noise makes it longer; a flow rate without a stated error is ignored.
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
        fields: dict[str, float | str | None] = {
            "axial_extent": self.axial_extent,
            "axial_length": self.axial_length,
            "unit_of_lengths": unit,
            "length_correlation": self.length_correlation,
            "capsule_velocity_relative": self.capsule_velocity,
        }
        if self.outline is not None:
            fields |= {"outline": self.outline.scale, "outline_correlation": self.outline.correlation_length}
        return fields if self.flow_rate is None else fields | {"flow_rate_relative": self.flow_rate}


def root_of(covariance: Floats) -> Floats:
    """Return the lower triangular root of a covariance (k, k), which may be singular."""
    # Eigenvectors and singular vectors would do, but their signs depend on the processor.
    ridge = 1e-14 * np.diag(covariance).max() + np.finfo(np.float64).tiny
    return np.asarray(np.linalg.cholesky(covariance + ridge * np.eye(len(covariance))))


def lab_attributes(model: ForwardModel, experiment: Experiment, errors: LabErrors) -> dict[str, str]:
    """Return model, experiment and errors as attributes of a file."""
    known = {name: getattr(experiment, name) for name in CONDITIONS}
    lab = {name: {"value": given.mean, "error": given.sd, "unit": given.unit} for name, given in known.items()}
    return {
        "model": model.name,
        "model_sha256": model.sha256,
        "cross_section": experiment.cross_section,
        "experiment": json.dumps(lab),
        "errors": json.dumps(errors.as_dict()),
        "version": __version__,
    }


def settings_of(measurement: Measurement, inputs: Inputs) -> dict[str, Quantity]:
    """Return the numeric inputs of a measurement, lengths with the unit "l" or "m"; an outline replaces them."""
    if inputs.flow_rate is not None and inputs.by_flow_rate:
        velocity, speed = "flow_rate", inputs.flow_rate
    else:
        velocity, speed = "capsule_velocity", inputs.capsule_velocity
    known = {"viscosity": inputs.viscosity, velocity: speed, "half_width": inputs.half_width}
    settings = {name: Quantity(given.value, given.error, PARAMETERS[name].si) for name, given in known.items()}
    unit = "l" if measurement.over_half_width else "m"
    if measurement.outline is None:
        settings["axial_extent"] = Quantity(measurement.axial_extent, measurement.axial_extent_error, unit)
    if measurement.outline is None or measurement.length_with_outline is not None:
        length, error = measurement.axial_length, measurement.axial_length_error
        if length is not None and error is not None:
            settings["axial_length"] = Quantity(length, error, unit)
    return settings


def flow_rate(mean_velocity: float, half_width: float, cross_section: str) -> float:
    """Return the flow rate Q of a mean velocity U [m^3/s]: U (2l)^2 in a square channel, U pi l^2 in a circular one.

    >>> round(6e10 * flow_rate(5e-3, 25e-6, "square"), 3)  # in uL/min
    0.75
    """
    return mean_velocity * half_width**2 * AREAS[cross_section]


# Capsules expected in an experiment, and its conditions, before anything is measured


@dataclass(frozen=True, eq=False)
class CapsuleDraws:
    """Independent draws of capsules, of the liquid and of the channel : (n,) arrays, SI."""

    surface_shear_modulus: Floats
    capsule_radius: Floats
    viscosity: Floats
    half_width: Floats

    @property
    def size_ratio(self) -> Floats:
        """a/l of each : (n,) array."""
        return size_ratio(capsule_radius=self.capsule_radius, half_width=self.half_width)

    def capillary_number(self, mean_velocity: float) -> Floats:
        """Return Ca of each at one mean velocity of the flow [m/s] : (n,) array."""
        return capillary_number(
            viscosity=self.viscosity, mean_velocity=mean_velocity, surface_shear_modulus=self.surface_shear_modulus
        )


@dataclass(frozen=True, eq=False)
class Expectation:
    """Expected G_s and a, with what is known of liquid and channel.

    >>> lab = Experiment(cross_section="square", half_width=25e-6, viscosity=0.8)
    >>> soon = Expectation.of("50 +/- 10 mN/m", 24e-6, lab)
    >>> soon.known, round(soon.centre.size_ratio.item(), 3)
    (False, 0.96)
    """

    surface_shear_modulus: Quantity
    capsule_radius: Quantity
    viscosity: Quantity
    half_width: Quantity

    @classmethod
    def of(cls, surface_shear_modulus: Given, capsule_radius: Given, experiment: Experiment) -> Expectation:
        """Return what is expected under the conditions of an experiment; refuse a G_s or a that is not positive."""
        return cls(
            Quantity.of(surface_shear_modulus, "surface_shear_modulus", where="expected"),
            Quantity.of(capsule_radius, "capsule_radius", where="expected"),
            experiment.viscosity,
            experiment.half_width,
        )

    @property
    def known(self) -> bool:
        """True if all values are known without error."""
        return all(quantity.known for quantity in self._all.values())

    @property
    def centre(self) -> CapsuleDraws:
        """Capsule with the expected values."""
        return CapsuleDraws(**{name: np.array([quantity.value]) for name, quantity in self._all.items()})

    def drawn(self, rng: np.random.Generator, count: int) -> CapsuleDraws:
        """Draw independently; one draw if all is known."""
        if self.known:
            return self.centre
        return CapsuleDraws(**{name: LogGrid.of(quantity).drawn(rng, count) for name, quantity in self._all.items()})

    def as_dict(self) -> dict[str, dict[str, float]]:
        """Return mean and standard deviation of each, SI."""
        return {name: {"value": quantity.value, "error": quantity.error} for name, quantity in self._all.items()}

    @property
    def _all(self) -> dict[str, Quantity]:
        return {name: getattr(self, name) for name in CapsuleDraws.__dataclass_fields__}


# Range of capillary numbers in which a model has shapes of one size

_SCANNED = 4001


@dataclass(frozen=True)
class CaRange:
    """Range of Ca at one a/l."""

    size_ratio: float
    lowest: float  # end of the model; NaN where it has no shape of this size
    highest: float
    limit: bool  # whether no steady shape is known above the highest, rather than none computed

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


def expected_range(model: ForwardModel, expectation: Expectation) -> CaRange:
    """Return the range of Ca of a model at the expected size; refuse a size that it does not have."""
    at_size = range_at(model, float(expectation.centre.size_ratio[0]))
    if np.isnan(at_size.highest):
        low, high = model.domain.bounds[1]
        wanted = f"a radius between {low:.4g} and {high:.4g} l, as {model.name} has them"
        raise InputError("flow_design", "capsule_radius", wanted, f"a/l = {at_size.size_ratio:.4g}")
    return at_size


@dataclass(frozen=True, eq=False)
class ModelEnds:
    """Range of Ca of a model over a/l."""

    sizes: Floats  # (b,): a/l, rising
    lowest: Floats  # (b,): end of the model there
    highest: Floats

    @classmethod
    def of(cls, model: ForwardModel, sizes: Floats) -> ModelEnds:
        """Return those of a model at sizes (b,) that it has."""
        ranges = [range_at(model, float(size)) for size in sizes]
        return cls(sizes, np.array([each.lowest for each in ranges]), np.array([each.highest for each in ranges]))

    def at(self, size: Floats) -> tuple[Floats, Floats]:
        """Return the lowest and the highest Ca at sizes : (n,) arrays."""
        return np.interp(size, self.sizes, self.lowest), np.interp(size, self.sizes, self.highest)
