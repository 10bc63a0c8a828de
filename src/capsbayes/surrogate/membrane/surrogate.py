"""The surrogate over flow and membrane: (Ca, a/l, alpha, K, h, B) to what is seen of a capsule."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Booleans, Floats
from capsbayes.measured_outline import MID_PLANE, check_view
from capsbayes.membrane_database import FREE_PARAMETERS, NULL_VALUES, RANGES, MembraneDatabase, covered
from capsbayes.model import CoordinateRange, ForwardModel
from capsbayes.prediction import Prediction
from capsbayes.profile import vertex_normals
from capsbayes.surrogate.caveats import with_unsure_shapes
from capsbayes.surrogate.membrane.coordinates import Frame
from capsbayes.surrogate.membrane.domain import MembraneDomain
from capsbayes.surrogate.membrane.kernel import averaged, each
from capsbayes.surrogate.membrane.local_fits import LocalFits, local_fits

_NUMBERS, _ERRING = 4, 3  # L_z, L_a, v_o/U and Lambda, of which the first have a covariance; then follow the modes
_LENGTH = 1  # of the numbers, L_a
_LOGARITHMIC = ("area_dilation_modulus", "bending")  # of which the order of magnitude is not known
_CHANGES = 0.3  # of the distance up to which states take part in predictions: over it the error changes
_ERROR = 0.8  # standard deviations of the error for one of the differences between local polynomials
OF_THE_MESH = 32.0
"""Variance of the whole error over that between the states. All states are of one mesh, of refinement 8, whose outlines
are 0.8e-3 l (median; rms 1.5e-3 l) from those of refinement 12, which differences between the states do not show. It is
the least power of two with which the drawn picture of the README (refinement 12) has its K and G_s in the intervals."""
_VARIANCE = OF_THE_MESH * _ERROR**2  # of the error, over that of the local polynomials


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
    _fits: LocalFits = field(init=False, repr=False)
    _frame: Frame = field(init=False, repr=False)

    def __post_init__(self) -> None:
        states = self.membrane_database
        values, kind = states["values"], "profile" if self.view == MID_PLANE else "silhouette"
        frame = Frame.of(values)
        both = np.concatenate([states["numbers"], states[kind]], axis=1)
        along = np.concatenate([states["numbers_along"], states[f"{kind}_along"]], axis=1)
        fits = local_fits(frame.points(values), both, frame.slopes(values, along), frame.points(states["lost"]))
        ranges = {
            name: CoordinateRange(*ends, null, name in _LOGARITHMIC)
            for name, ends, null in zip(FREE_PARAMETERS[2:], RANGES[2:], NULL_VALUES[2:], strict=True)
        }
        made = {
            "name": f"{states.cross_section}-membrane",
            "sha256": states.sha256,
            "domain": MembraneDomain(frame, fits, states.cross_section),
            "cross_section": states.cross_section,
            "coordinates": ranges,
            "_fits": fits,
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
        """Predict a batch; outside the domain NaN, with ``inside`` False."""
        means, covariances, _ = self._averaged(theta, self._width if outline else _NUMBERS, _ERRING)
        return self._prediction(means, covariances, outline=outline)

    def caveats(self, theta: Mapping[str, ArrayLike]) -> dict[str, Booleans]:
        """Return by kind whether a caveat concerns each point of a batch : (n,) arrays."""
        return with_unsure_shapes({}, self({name: np.atleast_1d(np.asarray(v, float)) for name, v in theta.items()}))

    def outline_modes(self, **theta: float) -> Floats:
        """Return the own error of the outline at one point, as independent displacements along its normals."""
        # One for each local polynomial that contributes at the point: the difference of its prediction from the mean.
        self.check_names(theta)
        values = parameter_columns({name: np.array([value]) for name, value in theta.items()})
        if not self.domain.contains(*values.T)[0]:
            raise self._outside(theta)
        weights, numbers = each(self._frame.points(values)[0], *self._fits)
        coefficients = numbers[:, _NUMBERS:]
        mean = weights @ coefficients
        shape = self.outlines_of(mean[None])[0]
        away = self.outlines_of(coefficients) - shape
        along = np.einsum("kpi,pi->kp", away, vertex_normals(shape))
        return np.asarray(np.sqrt(_VARIANCE * weights)[:, None] * along)

    def with_coefficients(self, theta: Mapping[str, Floats], *, errors: bool) -> tuple[Prediction, Floats, Floats]:
        """Predict a batch, its outlines as coefficients of their modes; NaN outside the domain.

        Parameters
        ----------
        theta : mapping
            As of a call.
        errors : bool
            Whether the error of the coefficients and of L_a is wanted.

        Returns
        -------
        Prediction, (n, k) array, (n, k + 1, k + 1) array [l]
            Predicted numbers, coefficients, and covariance of the errors of the coefficients and of L_a, which is
            (n, 0, 0) if it is not wanted.
        """
        means, covariances, _ = self._averaged(theta, self._width, self._width if errors else _NUMBERS)
        count = self._width - _NUMBERS
        covariance = np.empty((len(means), count + 1, count + 1) if errors else (len(means), 0, 0))
        if errors:
            covariance[:, :count, :count] = covariances[:, _NUMBERS:, _NUMBERS:]
            covariance[:, :count, count] = covariance[:, count, :count] = covariances[:, _NUMBERS:, _LENGTH]
            covariance[:, count, count] = covariances[:, _LENGTH, _LENGTH]
            covariance *= _VARIANCE
        return self._prediction(means, covariances, outline=False), means[:, _NUMBERS:], covariance

    def with_changes(
        self, theta: Mapping[str, Floats], moved: Sequence[Mapping[str, Floats]], *, outline: bool
    ) -> tuple[Prediction, Floats, Floats]:
        """Predict a batch, and to first order the changes of the predictions with the parameters.

        The changes are those of the local polynomials that are averaged there, at constant weights, also beyond the
        border. They are up to twice as near to the derivatives of simulated shapes as differences of predictions are.

        Parameters
        ----------
        theta : mapping
            As of a call.
        moved : sequence of mappings
            m sets of other parameters for each point.
        outline : bool
            Whether the coefficients of the outlines are wanted.

        Returns
        -------
        Prediction, (n, k) array, (m, n, 4 + k) array
            Predicted numbers; coefficients of the modes [l], k = 0 if they are not wanted; and the changes of L_z, L_a,
            v_o/U, the largest stretch and the coefficients.
        """
        width = self._width if outline else _NUMBERS
        means, covariances, slopes = self._averaged(theta, width, _ERRING, slopes=True)
        begin = self._frame.points(parameter_columns(theta))
        away = np.array([self._frame.points(parameter_columns(other)) - begin for other in moved])
        changes = np.einsum("nqa,mna->mnq", slopes, away)
        return self._prediction(means, covariances, outline=False), means[:, _NUMBERS:], changes

    def outlines_of(self, coefficients: Floats) -> Floats:
        """Return the outlines (n, p, 2) [l] with given coefficients (n, k) [l] of the modes."""
        flat = coefficients @ self.mode_shapes.reshape(coefficients.shape[1], -1)
        return self._mean + flat.reshape(-1, *self._mean.shape)

    @property
    def error_lengths(self) -> Floats:
        """Distances in ln Ca and a/l over which its own error changes : (2,) array.

        Between simulated capsules of one membrane the correlation of the error falls as exp(-r^2 / 2), r in these.
        """
        return self._change * self._frame.scale[:2]

    def membrane_places(self, theta: Mapping[str, Floats]) -> Floats:
        """Return scaled coordinates of the membranes of a batch : (n, 4) array.

        The model's own error changes over a distance of about one.
        """
        return np.asarray(self._frame.points(parameter_columns(theta))[:, 2:] / self._change)

    def distances_from_plain(self, name: str, values: Floats) -> Floats:
        """Return the distances of values (n,) of a parameter from that of the plain membrane : (n,) array.

        The unit is the distance over which the model's own error changes.
        """
        places = np.tile(np.array(NULL_VALUES), (len(values) + 1, 1))
        column = FREE_PARAMETERS.index(name)
        places[1:, column] = values
        along = self._frame.points(places)[:, column]
        return np.asarray(np.abs(along[1:] - along[0]) / self._change)

    @property
    def mode_shapes(self) -> Floats:
        """Displacements of the outline's vertices by each mode : (k, p, 2) array."""
        return self.membrane_database["profile_modes" if self.view == MID_PLANE else "silhouette_modes"]

    @property
    def stored_coefficients(self) -> Floats:
        """Coefficients of the modes for each stored state : (states, k) array [l]."""
        return self.membrane_database["profile" if self.view == MID_PLANE else "silhouette"]

    @property
    def _change(self) -> float:
        """Distance in scaled coordinates over which its own error changes."""
        return _CHANGES * float(np.median(self._fits.reaches))

    @property
    def _mean(self) -> Floats:
        return self.membrane_database["profile_mean" if self.view == MID_PLANE else "silhouette_mean"]

    @property
    def _width(self) -> int:
        return self._fits.coefficients.shape[1]

    def _averaged(
        self, theta: Mapping[str, Floats], width: int, spread: int, *, slopes: bool = False
    ) -> tuple[Floats, Floats, Floats]:
        """Return values (n, width), the covariance (n, spread, spread) of the differences, and slopes (n, width, 6)."""
        # The slopes are along the scaled coordinates; (0, width, 6) if they are not wanted.
        self.check_names(theta)
        values = parameter_columns(theta)
        inside = covered(values, self.membrane_database.cross_section)
        points = self._frame.points(values[inside])
        means, covariances, along = averaged(points, *self._fits, width, spread, slopes)
        if slopes:
            along = _spread_out(along, inside)
        return _spread_out(means, inside), _spread_out(covariances, inside), along

    def _prediction(self, means: Floats, covariances: Floats, *, outline: bool) -> Prediction:
        inside = np.isfinite(means[:, 0])
        shapes = self.outlines_of(means[:, _NUMBERS:]) if outline else None
        covariance = _VARIANCE * covariances[:, :_ERRING, :_ERRING]
        extent, length, velocity, stretch = means.T[:_NUMBERS]
        return Prediction(extent, length, velocity, stretch, covariance, inside, shapes)


def _spread_out(rows: Floats, inside: Booleans) -> Floats:
    """Return rows at the places of a mask (n,), and NaN elsewhere : (n, ...) array."""
    every = np.full((len(inside), *rows.shape[1:]), np.nan)
    every[inside] = rows
    return every


def parameter_columns(theta: Mapping[str, ArrayLike]) -> Floats:
    """Return the parameters (n, 6) of a batch, at their null values where they are not given."""
    count = np.shape(theta["capillary_number"])
    return np.stack(
        [
            np.broadcast_to(np.asarray(theta.get(name, null), np.float64), count)
            for name, null in zip(FREE_PARAMETERS, NULL_VALUES, strict=True)
        ],
        axis=1,
    )
