"""The surrogate over flow and membrane: (Ca, a/l, alpha, K, h, B) to what is seen of a capsule."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Booleans, Floats
from capsbayes.measured_outline import MID_PLANE, check_view
from capsbayes.membrane_database import FREE_PARAMETERS, NULL_VALUES, RANGES, MembraneDatabase
from capsbayes.model import CoordinateRange, ForwardModel
from capsbayes.prediction import Prediction
from capsbayes.profile import vertex_normals
from capsbayes.surrogate.caveats import with_unsure_shapes
from capsbayes.surrogate.membrane.coordinates import Frame
from capsbayes.surrogate.membrane.domain import MembraneDomain
from capsbayes.surrogate.membrane.kernel import averaged, each
from capsbayes.surrogate.membrane.local_fits import LocalFits, local_fits

_COLUMNS = 3  # L_z, L_a and v_o/U, which have a covariance
_LOGARITHMIC = ("area_dilation_modulus", "bending")  # of which the order of magnitude is not known
_ERROR = 0.8  # standard deviations of the error for one of the differences between local polynomials


@dataclass(frozen=True, eq=False)
class MembraneSurrogate(ForwardModel):
    """Forward model over six parameters, by diffuse approximation of scattered states with their derivatives.

    Parameters
    ----------
    membrane_database : MembraneDatabase
    view : str
        Outlines that it predicts: ``"mid-plane"`` or ``"silhouette"``.

    Examples
    --------
    >>> model = MembraneSurrogate.open("square")
    >>> soft = model.at(capillary_number=0.05, size_ratio=0.9)
    >>> hard = model.at(capillary_number=0.05, size_ratio=0.9, strain_hardening=0.8, pre_inflation=0.03)
    >>> bool(hard.parachute_depth[0] < soft.parachute_depth[0])
    True
    """

    membrane_database: MembraneDatabase
    view: str = MID_PLANE
    _numbers: LocalFits = field(init=False, repr=False)
    _outline: LocalFits = field(init=False, repr=False)
    _frame: Frame = field(init=False, repr=False)

    def __post_init__(self) -> None:
        states = self.membrane_database
        values, kind = states["values"], "profile" if self.view == MID_PLANE else "silhouette"
        frame = Frame.of(values)
        fits = [
            local_fits(frame.points(values), states[name], frame.slopes(values, states[f"{name}_along"]))
            for name in ("numbers", kind)
        ]
        ranges = {
            name: CoordinateRange(*ends, null, name in _LOGARITHMIC)
            for name, ends, null in zip(FREE_PARAMETERS[2:], RANGES[2:], NULL_VALUES[2:], strict=True)
        }
        made = {
            "name": f"{states.cross_section}-membrane",
            "sha256": states.sha256,
            "domain": MembraneDomain(frame, fits[0], frame.points(states["lost"])),
            "cross_section": states.cross_section,
            "coordinates": ranges,
            "_numbers": fits[0],
            "_outline": fits[1],
            "_frame": frame,
        }
        for key, value in made.items():
            object.__setattr__(self, key, value)

    @classmethod
    def open(cls, source: str | os.PathLike[str], *, view: str = MID_PLANE) -> MembraneSurrogate:
        """Make a surrogate of a shipped database, as ``"square"``, or of a file, by path with its ending .nc.

        Raises
        ------
        DatabaseError
            If the database cannot be read.
        InputError
            On an unknown view.
        """
        return cls(MembraneDatabase.open(source), check_view(view, "MembraneSurrogate", "view"))

    def __call__(self, theta: Mapping[str, Floats], *, outline: bool = False) -> Prediction:
        """Predict a batch; outside the domain NaN, with ``inside`` False.

        Parameters
        ----------
        theta : mapping
            ``"capillary_number"`` and ``"size_ratio"``, arrays (n,) [-], and any of the `coordinates`.
        outline : bool
            Whether to predict the outlines of its view too.
        """
        self.check_names(theta)
        values = _columns(theta)
        points, inside = self._points(values)
        means, covariances = averaged(points, *self._numbers, _COLUMNS)
        means[~inside], covariances[~inside] = np.nan, np.nan
        shapes = self._outlines(points, inside) if outline else None
        extent, length, velocity, stretch = means.T
        return Prediction(extent, length, velocity, stretch, _ERROR**2 * covariances, inside, shapes)

    def caveats(self, theta: Mapping[str, ArrayLike]) -> dict[str, Booleans]:
        """Return by kind whether a caveat concerns each point of a batch : (n,) arrays."""
        return with_unsure_shapes({}, self({name: np.atleast_1d(np.asarray(v, float)) for name, v in theta.items()}))

    def outline_modes(self, **theta: float) -> Floats:
        """Return the own error of the outline at one point, as independent displacements along its normals.

        Returns
        -------
        (k, p) array [l]
            One for each polynomial that reaches the point, by which the prediction of this differs from the mean.

        Raises
        ------
        OutsideDatabaseError
            When the point lies outside the domain.
        """
        self.check_names(theta)
        points, inside = self._points(_columns({name: np.array([value]) for name, value in theta.items()}))
        if not inside[0]:
            raise self._outside(theta)
        weights, coefficients = each(points[0], *self._outline)
        mean = weights @ coefficients
        shape = self.outlines_of(mean[None])[0]
        away = self.outlines_of(coefficients) - shape
        along = np.einsum("kpi,pi->kp", away, vertex_normals(shape))
        return np.asarray(_ERROR * np.sqrt(weights)[:, None] * along)

    def outline_coefficients(self, theta: Mapping[str, Floats], errors: int) -> tuple[Floats, Floats]:
        """Predict the outlines of a batch as coefficients of their modes; NaN outside the domain.

        Parameters
        ----------
        theta : mapping
            As of a call.
        errors : int
            Number e of leading modes whose error is stated.

        Returns
        -------
        (n, k) array, (n, e, e) array [l]
            The coefficients, and the covariance of their error.
        """
        points, inside = self._points(_columns(theta))
        coefficients, covariances = averaged(points, *self._outline, errors)
        coefficients[~inside], covariances[~inside] = np.nan, np.nan
        return coefficients, _ERROR**2 * covariances

    def outlines_of(self, coefficients: Floats) -> Floats:
        """Return the outlines (n, p, 2) [l] that coefficients (n, k) of the modes mean."""
        flat = coefficients @ self.mode_shapes.reshape(coefficients.shape[1], -1)
        return self._mean + flat.reshape(-1, *self._mean.shape)

    @property
    def mode_shapes(self) -> Floats:
        """Displacements of the outline's vertices by each mode : (k, p, 2) array."""
        return self.membrane_database["profile_modes" if self.view == MID_PLANE else "silhouette_modes"]

    @property
    def stored_coefficients(self) -> Floats:
        """Coefficients of the modes for each stored state : (states, k) array [l]."""
        return self.membrane_database["profile" if self.view == MID_PLANE else "silhouette"]

    @property
    def _mean(self) -> Floats:
        return self.membrane_database["profile_mean" if self.view == MID_PLANE else "silhouette_mean"]

    def _points(self, values: Floats) -> tuple[Floats, Booleans]:
        inside = self.domain.contains(*values.T)
        known = np.where(inside[:, None], values, NULL_VALUES)
        return self._frame.points(known), inside

    def _outlines(self, points: Floats, inside: Booleans) -> Floats:
        shapes = np.full((len(points), *self._mean.shape), np.nan)
        coefficients, _ = averaged(points[inside], *self._outline, 1)
        shapes[inside] = self.outlines_of(coefficients)
        return shapes


def _columns(theta: Mapping[str, ArrayLike]) -> Floats:
    """Return the parameters (n, 6) of a batch, at their null values where they are not given."""
    count = np.shape(theta["capillary_number"])
    return np.stack(
        [
            np.broadcast_to(np.asarray(theta.get(name, null), np.float64), count)
            for name, null in zip(FREE_PARAMETERS, NULL_VALUES, strict=True)
        ],
        axis=1,
    )
