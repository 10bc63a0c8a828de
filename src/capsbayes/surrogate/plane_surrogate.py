"""Surrogate of a database of steady shapes over the (Ca, a/l) plane, with its own error.

Each branch of steady shapes has a smooth approximation over its part of the
plane. A query is answered by the branch whose region it lies in; outside all
regions there is no answer.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Booleans, Floats
from capsbayes.database import Database
from capsbayes.errors import InputError
from capsbayes.measured_outline import MID_PLANE, check_view
from capsbayes.model import ForwardModel
from capsbayes.prediction import Prediction
from capsbayes.surrogate.branch_surrogate import CELLS, COLUMNS, BranchSurrogate, approximation_of
from capsbayes.surrogate.branches import Branch, branches_of
from capsbayes.surrogate.caveats import Caveats, with_unsure_shapes
from capsbayes.surrogate.diffuse import DiffuseApproximation
from capsbayes.surrogate.domain import DomainOfExistence
from capsbayes.surrogate.scaling import PlaneScaling


@dataclass(frozen=True, eq=False)
class PlaneSurrogate(ForwardModel):
    """Forward model (Ca, a/l) -> (L_z, L_a, v_o/U, Lambda, outline) over a database; parameters as of `Surrogate`."""

    database: Database = field()
    cells: tuple[int, int] = CELLS
    view: str = MID_PLANE
    domain: DomainOfExistence = field(init=False, repr=False)
    branches: tuple[BranchSurrogate, ...] = field(init=False, repr=False)
    case_caveats: Caveats = field(init=False, repr=False)

    def __post_init__(self) -> None:
        view = check_view(self.view, "Surrogate", "view")
        if not isinstance(self.database, Database):
            advice = "open it first: Database.open(...)"
            raise InputError("Surrogate", "database", "a Database", repr(self.database)[:60], advice)
        cases, attributes = self.database.converged, self.database.dataset.attrs
        branches = branches_of(self.database)
        scaling = PlaneScaling.of(cases["capillary_number"], cases["size_ratio"])
        smooth = [approximation_of(cases, branch, scaling) for branch in branches]
        rivals = smooth[::-1] if len(branches) == 2 else [None]
        name = re.sub(r"[^a-z0-9]+", "-", f"{attributes['cross_section']}-{attributes['law']}".lower())

        def smoothed(branch: Branch, rival: DiffuseApproximation | None) -> BranchSurrogate:
            return BranchSurrogate(cases, branch, scaling, rival, self.cells, view)

        with ThreadPoolExecutor() as pool:  # most of it is compiled, and runs on one core for each branch
            parts = tuple(pool.map(smoothed, branches, rivals))
        made = {
            "name": name if view == MID_PLANE else f"{name} ({view}s)",
            "sha256": self.database.sha256,
            "cross_section": attributes["cross_section"],
            "view": view,
            "domain": DomainOfExistence(tuple(branch.region for branch in branches)),
            "branches": parts,
            "case_caveats": Caveats.of(cases, scaling),
        }
        for key, value in made.items():
            object.__setattr__(self, key, value)

    def __call__(self, theta: Mapping[str, Floats], *, outline: bool = False) -> Prediction:
        """Predict a batch; outside the domain NaN, with ``inside`` False."""
        self.check_names(theta)
        ca, size = _pair(theta["capillary_number"], theta["size_ratio"])
        values, covariance = np.full((len(COLUMNS), len(ca)), np.nan), np.full((len(ca), 3, 3), np.nan)
        inside = np.zeros(len(ca), dtype=np.bool_)
        for part in self.branches:
            part.predict(ca, size, values.T, covariance, inside)
        shapes = self._outlines(ca, size) if outline else None
        return Prediction(values[0], values[1], values[2], values[3], covariance, inside, shapes)

    def caveats(self, theta: Mapping[str, ArrayLike]) -> dict[str, Booleans]:
        """Return by kind whether a caveat concerns each point of a batch : (n,) arrays."""
        ca, size = _pair(theta["capillary_number"], theta["size_ratio"])
        return with_unsure_shapes(self.case_caveats(ca, size), self({"capillary_number": ca, "size_ratio": size}))

    def outline_modes(self, **theta: float) -> Floats:
        """Return the own error of the outline at one point, as independent displacements along its normals."""
        self.check_names(theta)
        point = theta["capillary_number"], theta["size_ratio"]
        for part in self.branches:
            if part.branch.region.contains(np.array(point[:1]), np.array(point[1:]))[0]:
                return part.outline_modes(*point)
        raise self._outside(theta)

    def gradient(self, *, capillary_number: ArrayLike, size_ratio: ArrayLike) -> Floats:
        """Derivatives of (L_z, L_a, v_o/U) by (Ca, a/l) : (n, 3, 2) array, NaN outside the domain."""
        ca, size = _pair(capillary_number, size_ratio)
        gradient = np.full((len(ca), 3, 2), np.nan)
        for part in self.branches:
            here = part.branch.region.contains(ca, size)
            gradient[here] = part.slopes(ca[here], size[here])
        return gradient

    def _outlines(self, ca: Floats, size: Floats) -> Floats:
        outlines = np.full((len(ca), self.database.dataset.sizes["point"], 2), np.nan)
        for part in self.branches:
            here = np.flatnonzero(part.branch.region.contains(ca, size))
            if len(here):
                outlines[here] = part.outlines(ca[here], size[here])
        return outlines


def _pair(capillary_number: ArrayLike, size_ratio: ArrayLike) -> tuple[Floats, Floats]:
    ca, size = np.broadcast_arrays(np.atleast_1d(capillary_number), np.atleast_1d(size_ratio))
    return np.ascontiguousarray(ca, np.float64), np.ascontiguousarray(size, np.float64)
