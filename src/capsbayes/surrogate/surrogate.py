"""The surrogate: a database of steady shapes as a fast forward model with its own error.

Each branch of steady shapes is a smooth sheet over its part of the (Ca, a/l)
plane. A query is answered by the sheet whose region it lies in; outside all of
them there is no answer.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from capsbayes.database import NO_EFFECT, Database
from capsbayes.errors import InputError
from capsbayes.measured_outline import MID_PLANE, check_view
from capsbayes.model import ForwardModel
from capsbayes.prediction import Prediction
from capsbayes.surrogate.branches import branches_of
from capsbayes.surrogate.chart import Chart
from capsbayes.surrogate.domain import DomainOfExistence
from capsbayes.surrogate.doubts import Doubts
from capsbayes.surrogate.effect_surrogate import SLICE_CELLS, EffectSurrogate, check_values
from capsbayes.surrogate.sheet import CELLS, COLUMNS, Sheet, approximation_of

__all__ = ["Surrogate", "joint_surrogate"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Surrogate(ForwardModel):
    """Forward model (Ca, a/l) -> (L_z, L_a, v_o/U, Lambda, outline) over a database.

    Parameters
    ----------
    database : Database
        Steady shapes, in columns of equal a/l.
    cells : tuple of int
        Of the tables of its sheets, along sqrt(Ca) and a/l.
    view : str
        Outlines that it predicts: ``"mid-plane"``, in the plane x = 0, or ``"silhouette"``, as in a photograph.

    Attributes
    ----------
    domain : DomainOfExistence
        Where it has an answer.
    sheets : tuple of Sheet
        One for each branch of steady shapes.

    Examples
    --------
    >>> model = Surrogate.open("square-neo-hookean")
    >>> capsule = model.at(capillary_number=0.082, size_ratio=0.96)
    >>> [round(float(value), 2) for value in capsule.values[0]]
    [2.15, 1.82, 1.3]
    >>> int(model({"capillary_number": np.array([0.05, 0.5]), "size_ratio": np.array([0.9, 0.9])}).inside.sum())
    1
    """

    database: Database = field()
    cells: tuple[int, int] = CELLS
    view: str = MID_PLANE
    domain: DomainOfExistence = field(init=False, repr=False)
    sheets: tuple[Sheet, ...] = field(init=False, repr=False)
    _doubts: Doubts = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "view", check_view(self.view, "Surrogate", "view"))
        cases = self.database.converged
        branches = branches_of(self.database)
        chart = Chart.of(cases["capillary_number"], cases["size_ratio"])
        object.__setattr__(self, "domain", DomainOfExistence(tuple(branch.region for branch in branches)))
        smooth = [approximation_of(cases, branch, chart) for branch in branches]
        rivals = smooth[::-1] if len(branches) == 2 else [None]
        pairs = zip(branches, rivals, strict=True)
        sheets = tuple(Sheet(cases, branch, chart, rival, self.cells, self.view) for branch, rival in pairs)
        object.__setattr__(self, "sheets", sheets)
        object.__setattr__(self, "_doubts", Doubts.of(cases, chart))
        attributes = self.database.dataset.attrs
        name = re.sub(r"[^a-z0-9]+", "-", f"{attributes['section']}-{attributes['law']}".lower())
        object.__setattr__(self, "name", name + ("" if self.view == MID_PLANE else f" ({self.view}s)"))
        object.__setattr__(self, "sha256", self.database.sha256)
        object.__setattr__(self, "cross_section", attributes["section"])

    @classmethod
    def open(cls, source: str | Path, *, view: str = MID_PLANE) -> Surrogate | EffectSurrogate:
        """Make a surrogate of a shipped database (by name) or of a file (by path, with its ending .nc).

        The base of an effect database is the shipped one of its section and law, if there is one.

        Parameters
        ----------
        source : str or path
        view : str
            View of the outlines that it predicts: ``"mid-plane"`` or ``"silhouette"``.

        Raises
        ------
        DatabaseError
            If the database cannot be read.
        InputError
            On another word for the view.
        """
        view = check_view(view, "Surrogate", "view")
        is_file = isinstance(source, Path) or str(source).endswith(".nc")
        database = Database.read(source) if is_file else Database.open(str(source))
        base = database.plain_relative() if database.effect != NO_EFFECT else None
        return cls.from_database(database, base=base, view=view)

    @classmethod
    def from_database(
        cls, database: Database, *, base: Database | Surrogate | None = None, view: str | None = None
    ) -> Surrogate | EffectSurrogate:
        """Make a surrogate; that of an effect database has the effect as one more coordinate.

        Parameters
        ----------
        database : Database
        base : Database or Surrogate, optional
            For an effect database, a plain one of a finer mesh at the null value; by default the null slice itself.
        view : str, optional
            View of the outlines: ``"mid-plane"`` or ``"silhouette"``; by default that of the base, or the mid-plane.

        Raises
        ------
        DatabaseError
            If an effect database has too few values or not the null value, or if the base is of another section.
        InputError
            On another word for the view, or if it is not that of the base.
        """
        of_base = base.view if isinstance(base, Surrogate) else MID_PLANE
        view = of_base if view is None else check_view(view, "Surrogate", "view")
        if database.effect == NO_EFFECT:
            return cls(database, view=view)
        check_values(database)
        if isinstance(base, Surrogate) and base.view != view:
            raise InputError("Surrogate", "view", f'"{base.view}", that of the base', repr(view))
        slices = {value: cls(database.at_value(value), SLICE_CELLS, view) for value in database.values}
        plain = cls(base, view=view) if isinstance(base, Database) else base
        return EffectSurrogate(
            database, tuple(slices.values()), slices[database.null_value] if plain is None else plain
        )

    def __call__(self, theta: Mapping[str, NDArray[np.float64]], *, outline: bool = False) -> Prediction:
        """Predict a batch; outside the domain NaN, with ``inside`` False.

        Parameters
        ----------
        theta : mapping
            ``"capillary_number"`` and ``"size_ratio"``, arrays (n,) [-].
        outline : bool
            Whether to predict the outlines of its view too.
        """
        self.check_names(theta)
        ca, size = _pair(theta["capillary_number"], theta["size_ratio"])
        values, covariance = np.full((len(COLUMNS), len(ca)), np.nan), np.full((len(ca), 3, 3), np.nan)
        inside = np.zeros(len(ca), dtype=np.bool_)
        for sheet in self.sheets:
            sheet.predict(ca, size, values.T, covariance, inside)
        shapes = self._outlines(ca, size) if outline else None
        return Prediction(values[0], values[1], values[2], values[3], covariance, inside, shapes)

    def caveats(self, theta: Mapping[str, ArrayLike]) -> dict[str, NDArray[np.bool_]]:
        """Return by kind whether a caveat concerns each point of a batch : (n,) arrays."""
        return self._doubts(*_pair(theta["capillary_number"], theta["size_ratio"]))

    def outline_modes(self, **theta: float) -> Floats:
        """Return the own error of the outline at one point, as independent displacements along its normals.

        Returns
        -------
        (k, p) array [l]
            Each one standard deviation.

        Raises
        ------
        OutsideDatabaseError
            When the point lies outside the domain.
        """
        self.check_names(theta)
        point = theta["capillary_number"], theta["size_ratio"]
        for sheet in self.sheets:
            if sheet.branch.region.contains(np.array(point[:1]), np.array(point[1:]))[0]:
                return sheet.outline_modes(*point)
        raise self._outside(theta)

    def joined(self, effect_database: str) -> EffectSurrogate:
        """Return the model with a shipped effect database as a further coordinate, and this one as its base."""
        return joint_surrogate(effect_database, self, self.view)

    def gradient(self, *, capillary_number: ArrayLike, size_ratio: ArrayLike) -> Floats:
        """Derivatives of (L_z, L_a, v_o/U) by (Ca, a/l) : (n, 3, 2) array, NaN outside the domain."""
        ca, size = _pair(capillary_number, size_ratio)
        gradient = np.full((len(ca), 3, 2), np.nan)
        for sheet in self.sheets:
            here = sheet.branch.region.contains(ca, size)
            gradient[here] = sheet.slopes(ca[here], size[here])
        return gradient

    def _outlines(self, ca: Floats, size: Floats) -> Floats:
        outlines = np.full((len(ca), self.database.dataset.sizes["point"], 2), np.nan)
        for sheet in self.sheets:
            here = sheet.branch.region.contains(ca, size)
            outlines[here] = sheet.outlines(ca[here], size[here])
        return outlines


@lru_cache(maxsize=16)
def joint_surrogate(effect_database: str, base: Surrogate | None, view: str) -> EffectSurrogate:
    """Return the surrogate of a shipped effect database over a base, by default the shipped one; kept for later calls.

    Parameters
    ----------
    effect_database : str
        Name.
    base : Surrogate or None
    view : str
    """
    if base is None:
        found = Surrogate.open(effect_database, view=view)
    else:
        found = Surrogate.from_database(Database.open(effect_database), base=base, view=view)
    assert isinstance(found, EffectSurrogate), "an effect database"
    return found


def _pair(capillary_number: ArrayLike, size_ratio: ArrayLike) -> tuple[Floats, Floats]:
    ca, size = np.broadcast_arrays(np.atleast_1d(capillary_number), np.atleast_1d(size_ratio))
    return np.ascontiguousarray(ca, np.float64), np.ascontiguousarray(size, np.float64)
