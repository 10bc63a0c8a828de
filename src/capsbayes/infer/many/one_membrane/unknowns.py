"""Coordinates in which the membrane of a batch and the spreads of its population are drawn."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import ndtr, ndtri

from capsbayes.arrays import Floats
from capsbayes.infer.many.one_membrane.conditional import Spreads
from capsbayes.infer.prior import THICKNESS, Coordinate

_WIDEST = (1.0, 0.5, 0.5)  # scales of half-normal priors of the spreads of ln G_s, of a/l and of ln alpha
_NARROWEST = 1e-4  # below it G_s and a are the same for all; their weights would cancel to fewer digits than are needed
_USUAL, _WIDTH = (np.log(0.15), np.log(0.06), np.log(0.2)), np.log(3.0)  # of logs: where spreads are sought


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Points (normal scores of the unknown coordinates under their priors, logs of the unknown spreads).

    Parameters
    ----------
    coordinates : tuple of Coordinate
        Those that are unknown.
    known : mapping of str to float
        The others.
    spreads : tuple of float or None
        Standard deviations of ln G_s and of a/l from capsule to capsule, and of ln alpha if it varies; None if unknown.
    """

    coordinates: tuple[Coordinate, ...]
    known: Mapping[str, float] = field(default_factory=dict)
    spreads: tuple[float | None, ...] = (None, None)

    @classmethod
    def of(
        cls, coordinates: Iterable[Coordinate], known: Mapping[str, float], spreads: tuple[float | None, ...]
    ) -> Unknowns:
        """Return those of coordinates with their priors, of which a thickness may be known, beside known ones."""
        each = tuple(coordinates)
        free = tuple(one for one in each if not one.distribution.known)
        thickness = {key_of(one): one.distribution.value for one in each if one.distribution.known}
        return cls(free, {**known, **thickness}, spreads)

    def fixed(self, values: Mapping[str, float]) -> Unknowns:
        """Return the same with known values of some coordinates."""
        free = tuple(one for one in self.coordinates if one.name not in values)
        return replace(self, coordinates=free, known={**self.known, **values})

    @property
    def scores(self) -> int:
        """Number of unknown coordinates: the first columns of a point."""
        return len(self.coordinates)

    @property
    def dimensions(self) -> int:
        """Number of columns of a point."""
        return self.scores + len(self.sought)

    @property
    def sought(self) -> tuple[int, ...]:
        """Which of the spreads are unknown."""
        return tuple(which for which, spread in enumerate(self.spreads) if spread is None)

    def wide(self, uniform: Floats) -> Floats:
        """Return points (d, p) of the unit cube (d, p) as draws of the priors, spreads about what is usual."""
        points = ndtri(uniform)
        for column, which in enumerate(self.sought, self.scores):
            points[:, column] = _USUAL[which] + _WIDTH * points[:, column]
        return np.asarray(points)

    def log_wide(self, points: Floats) -> Floats:
        """Return the log density of `wide` : (d,) array."""
        middle, width = np.zeros(self.dimensions), np.ones(self.dimensions)
        for column, which in enumerate(self.sought, self.scores):
            middle[column], width[column] = _USUAL[which], _WIDTH
        away = (points - middle) / width
        return np.asarray(-0.5 * np.sum(away**2 + np.log(2.0 * np.pi) + 2.0 * np.log(width), axis=1))

    def membranes(self, points: Floats) -> dict[str, Floats]:
        """Return the coordinates of the model at points (d, p), by name : (d,) arrays; thickness for bending."""
        shares = ndtr(points[:, : self.scores])
        found = {key_of(one): one.values(share) for one, share in zip(self.coordinates, shares.T, strict=True)}
        return found | {name: np.full(len(points), value) for name, value in self.known.items()}

    def spreads_at(self, points: Floats) -> Spreads:
        """Return the spreads at points (d, p)."""
        columns = [np.full(len(points), np.nan if spread is None else spread) for spread in self.spreads]
        for column, which in enumerate(self.sought, self.scores):
            columns[which] = np.maximum(np.exp(points[:, column]), _NARROWEST)
        return Spreads(*columns)

    def log_prior(self, points: Floats) -> Floats:
        """Return the log of the prior density : (d,) array."""
        scores = points[:, : self.scores]
        logs = -0.5 * np.sum(scores**2 + np.log(2.0 * np.pi), axis=1)
        for column, which in enumerate(self.sought, self.scores):
            log_spread = points[:, column]
            share = np.exp(log_spread) / _WIDEST[which]
            logs = logs + 0.5 * np.log(2.0 / np.pi) - np.log(_WIDEST[which]) + log_spread - 0.5 * share**2
        return np.asarray(logs)


def key_of(coordinate: Coordinate) -> str:
    """Return the name of what a coordinate's distribution is of."""
    return THICKNESS if coordinate.by_thickness else coordinate.name
