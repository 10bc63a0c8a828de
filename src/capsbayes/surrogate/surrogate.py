"""The surrogate: a database of steady shapes as a fast forward model with its own error.

Moving least squares over (log Ca, a/l) give L_z, L_a, v_o/U and Lambda; they
are tabulated once, with their gradients, on a lattice much finer than the
cases, and a query reads the table. Outlines are asked for seldom and come from
the moving least squares themselves.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import binary_dilation

from capsbayes.database import Database
from capsbayes.errors import OutsideDatabaseError
from capsbayes.prediction import Prediction
from capsbayes.surrogate.chart import Chart
from capsbayes.surrogate.diffuse import DiffuseApproximation, leave_one_out
from capsbayes.surrogate.domain import DomainOfExistence, inside_borders
from capsbayes.surrogate.own_error import OwnError, mesh_error_of
from capsbayes.surrogate.table import HermiteTable, hermite

__all__ = ["Surrogate", "approximation_of"]

Floats = NDArray[np.float64]

COLUMNS = ("axial_extent", "axial_length", "velocity_ratio", "stretch_ratio")
CELLS = (240, 180)


@dataclass(frozen=True, eq=False)
class Surrogate:
    """Forward model (Ca, a/l) -> (L_z, L_a, v_o/U, Lambda, outline) over a database.

    Parameters
    ----------
    database : Database
        Steady shapes, in columns of equal a/l.

    Examples
    --------
    >>> from capsbayes.surrogate import Surrogate
    >>> model = Surrogate.open("square-neo-hookean")
    >>> one = model.at(capillary_number=0.082, size_ratio=0.96)
    >>> bool(abs(one.axial_extent[0] - 2.14) < 0.03)
    True
    """

    database: Database
    domain: DomainOfExistence = field(init=False)
    approximation: DiffuseApproximation = field(init=False, repr=False)
    chart: Chart = field(init=False, repr=False)
    _outlines: DiffuseApproximation = field(init=False, repr=False)
    _frame: tuple[Any, ...] = field(init=False, repr=False)
    _table: HermiteTable = field(init=False, repr=False)
    _covariance: Floats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        cases, chart = self.database.converged, Chart()
        approximation = approximation_of(self.database, chart)
        nodes = approximation.nodes
        outlines = replace(approximation, values=cases["profile"].reshape(len(nodes), -1))
        domain = DomainOfExistence.of(self.database)
        lattice, wanted = _lattice(domain, chart)
        table = HermiteTable.of(approximation.with_gradient, lattice[0, 0], lattice[-1, -1], cells=CELLS, wanted=wanted)
        residuals = (leave_one_out(approximation) - approximation.values)[:, :3]
        covariance = np.full((*wanted.shape, 3, 3), np.nan)
        covariance[wanted] = OwnError(nodes, residuals).covariance(lattice[wanted])
        mesh = mesh_error_of(self.database.dataset.attrs) * table.coefficients[:, :, 0, :3]
        covariance[..., range(3), range(3)] += mesh**2
        made = {
            "domain": domain,
            "approximation": approximation,
            "chart": chart,
            "_outlines": outlines,
            "_table": table,
            "_frame": (domain.size_ratio, domain.lowest, domain.highest, *chart.steps, *table.origin, *table.step),
            "_covariance": covariance,
        }
        for name, value in made.items():
            object.__setattr__(self, name, value)

    @classmethod
    def open(cls, source: str | Path) -> Surrogate:
        """Make a surrogate of a shipped database (by name) or of a file (by path, with its ending .nc)."""
        is_file = isinstance(source, Path) or str(source).endswith(".nc")
        return cls(Database.read(source) if is_file else Database.open(str(source)))

    @property
    def name(self) -> str:
        """Section and law, for results."""
        return f"{self.database.dataset.attrs['section']}-{self.database.dataset.attrs['law']}"

    @property
    def sha256(self) -> str:
        """Fingerprint of the database."""
        return self.database.sha256

    def __call__(self, theta: Mapping[str, NDArray[np.float64]], *, outline: bool = False) -> Prediction:
        """Predict a batch; outside the domain NaN, with ``inside`` False.

        Parameters
        ----------
        theta : mapping
            ``"capillary_number"`` and ``"size_ratio"``, arrays (n,) [-].
        outline : bool
            Whether to predict the mid-plane outlines too.
        """
        ca, size = _pair(theta["capillary_number"], theta["size_ratio"])
        values, covariance = np.empty((len(COLUMNS), len(ca))), np.empty((len(ca), 3, 3))
        inside = np.empty(len(ca), dtype=np.bool_)
        _predict(ca, size, self._frame, self._table.coefficients, self._covariance, values.T, covariance, inside)
        shapes = self._outlines_at(ca, size, inside) if outline else None
        return Prediction(values[0], values[1], values[2], values[3], covariance, inside, shapes)

    def at(self, *, capillary_number: float, size_ratio: float, outline: bool = False) -> Prediction:
        """Predict one point.

        Raises
        ------
        OutsideDatabaseError
            When the point lies outside the domain, saying on which side.
        """
        theta = {"capillary_number": np.array([capillary_number]), "size_ratio": np.array([size_ratio])}
        prediction = self(theta, outline=outline)
        if not prediction.inside[0]:
            reason = self.domain.reason(capillary_number, size_ratio)
            raise OutsideDatabaseError(capillary_number, size_ratio, reason)
        return prediction

    def gradient(self, *, capillary_number: ArrayLike, size_ratio: ArrayLike) -> Floats:
        """Derivatives of (L_z, L_a, v_o/U) by (Ca, a/l) : (n, 3, 2) array, NaN outside the domain."""
        ca, size = _pair(capillary_number, size_ratio)
        gradient = np.full((len(ca), 3, 2), np.nan)
        inside = self.domain.contains(ca, size)
        slopes = self._table.with_gradient(self.chart.to_plane(ca[inside], size[inside]))[1][:, :3]
        gradient[inside] = slopes * self.chart.slopes(ca[inside])[:, None, :]
        return gradient

    def _outlines_at(self, ca: Floats, size: Floats, inside: NDArray[np.bool_]) -> Floats:
        flat = np.full((len(ca), self._outlines.values.shape[1]), np.nan)
        flat[inside] = self._outlines(self.chart.to_plane(ca[inside], size[inside]))
        return flat.reshape(len(ca), -1, 2)


def approximation_of(database: Database, chart: Chart) -> DiffuseApproximation:
    """Moving least squares of (L_z, L_a, v_o/U, Lambda) over the converged cases."""
    cases = database.converged
    nodes = chart.to_plane(cases["capillary_number"], cases["size_ratio"])
    return DiffuseApproximation(nodes, np.stack([cases[name] for name in COLUMNS], axis=1))


def _pair(capillary_number: ArrayLike, size_ratio: ArrayLike) -> tuple[Floats, Floats]:
    ca, size = np.broadcast_arrays(np.atleast_1d(capillary_number), np.atleast_1d(size_ratio))
    return np.ascontiguousarray(ca, np.float64), np.ascontiguousarray(size, np.float64)


def _lattice(domain: DomainOfExistence, chart: Chart) -> tuple[Floats, NDArray[np.bool_]]:
    """Points of the table's lattice (i, j, 2), and which of them lie in the domain or within two cells of it."""
    (ca_low, ca_high), (size_low, size_high) = domain.bounds
    low, high = chart.to_plane([ca_low, ca_high], [size_low, size_high])
    axes = [np.linspace(low[k], high[k], CELLS[k] + 1) for k in range(2)]
    lattice = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    ca, size = chart.from_plane(lattice.reshape(-1, 2)).T
    size = np.clip(size, size_low, size_high)  # rounding must not push the outer rows out
    inside = domain.contains(ca, size).reshape(lattice.shape[:2])
    return lattice, binary_dilation(inside, np.ones((5, 5), dtype=bool))


@njit(cache=True, nogil=True)
def _predict(ca, size, frame, coefficients, errors, values, covariance, inside):  # type: ignore[no-untyped-def]
    """Fill values (n, 4), covariance (n, 3, 3) and inside (n,) from the table and the lattice of covariances."""
    columns, lowest, highest, ca_step, size_step, x_origin, y_origin, x_step, y_step = frame
    one, no_slopes = np.empty(coefficients.shape[3]), np.empty((0, 2))
    for n in range(len(ca)):
        inside[n] = inside_borders(ca[n], size[n], columns, lowest, highest)
        if not inside[n]:
            values[n] = np.nan
            covariance[n] = np.nan
            continue
        x = (np.log(ca[n]) / ca_step - x_origin) / x_step
        y = (size[n] / size_step - y_origin) / y_step
        hermite(x, y, coefficients, one, no_slopes)
        values[n] = one
        _bilinear(x, y, errors, covariance[n])


@njit(cache=True, nogil=True)
def _bilinear(x, y, lattice, out):  # type: ignore[no-untyped-def]
    """Convex mean of the matrices at the four lattice points around, so that it stays a covariance."""
    i = min(max(int(x), 0), lattice.shape[0] - 2)
    j = min(max(int(y), 0), lattice.shape[1] - 2)
    s, t = x - i, y - j
    for k in range(3):
        for m in range(3):
            left = (1.0 - t) * lattice[i, j, k, m] + t * lattice[i, j + 1, k, m]
            right = (1.0 - t) * lattice[i + 1, j, k, m] + t * lattice[i + 1, j + 1, k, m]
            out[k, m] = (1.0 - s) * left + s * right
