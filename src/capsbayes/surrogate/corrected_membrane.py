"""The surrogate over the membrane, corrected by finer databases where no more than one parameter differs.

The plain database and those over one parameter of the membrane are of a finer mesh than the states scattered over all
of them, and these are fewest at the border of their range, where the plain membrane lies. The finer databases answer
where no more than one parameter differs from the plain membrane. Where several do, the scattered states answer,
corrected by what the finer databases are known to differ from them: by R_0 at the plain membrane, by R_i where only
parameter i differs. This difference is taken as a random field whose correlation falls as exp(-x), x the distance along
each parameter in lengths over which the error of the scattered states changes; the correction is its expectation given
the known ones (simple kriging). As the correlations of the parameters multiply, it has a closed form, with X the sum of
all x:

    exp(-X) R_0 + sum_i exp(-(X - x_i)) (R_i - exp(-x_i) R_0).

With a single i this is R_i, so that nothing jumps where a second parameter begins to differ.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Booleans, Floats
from capsbayes.database import Database
from capsbayes.membrane_database import FREE_PARAMETERS, NULL_VALUES
from capsbayes.model import Domain, ForwardModel
from capsbayes.parameters import OF_THE_MEMBRANE
from capsbayes.prediction import NUMBERS, Prediction
from capsbayes.surrogate.membrane import FixedMembraneDomain, MembraneSurrogate, parameter_columns
from capsbayes.surrogate.plane import aligned

_NOTHING = 1e-4  # weight of a known error below which it does not count
_OF_FLOW = 2  # first parameters, those of the flow

Names = tuple[str, ...]


class CorrectedMembrane(ForwardModel):
    """Forward model over Ca, a/l and the parameters of the membrane: `joint` on top of a plain surrogate, the base.

    The base, of neo-Hookean capsules without inflation, is to be `joined` with the databases over one parameter: where
    the joint surrogate does not hold, the changes due to each parameter alone are added up.
    """

    def __init__(self, base: ForwardModel, joint: MembraneSurrogate) -> None:
        self.base, self.joint = base, joint
        self.name = f"{base.name} with {joint.name}"
        self.sha256 = hashlib.sha256(f"{base.sha256} {joint.sha256}".encode()).hexdigest()
        self.domain = _CorrectedDomain(self)
        self.cross_section, self.view, self.database = base.cross_section, base.view, base.database
        self.coordinates = dict(joint.coordinates)
        of_each = {(name,): f"{base.cross_section}-{name.replace('_', '-')}" for name in joint.coordinates}
        shipped = Database.shipped()
        self._databases = {names: database for names, database in of_each.items() if database in shipped}

    def with_membrane(self) -> CorrectedMembrane:
        return self

    def __call__(self, theta: Mapping[str, Floats], *, outline: bool = False) -> Prediction:
        self.check_names(theta)
        values = parameter_columns(theta)
        differ = values[:, _OF_FLOW:] != NULL_VALUES[_OF_FLOW:]
        kinds = np.unique(differ, axis=0)
        if len(kinds) == 1:
            return self._predicted(_chosen(kinds[0]), values, outline)
        rows = [np.flatnonzero(np.all(differ == kind, axis=1)) for kind in kinds]
        parts = [self._predicted(_chosen(kind), values[some], outline) for kind, some in zip(kinds, rows, strict=True)]
        order = np.argsort(np.concatenate(rows))
        names = (*NUMBERS, "covariance", "inside", *(["outline"] if outline else []))
        return Prediction(**{name: np.concatenate([getattr(part, name) for part in parts])[order] for name in names})

    def outline_modes(self, **theta: float) -> Floats:
        # These are the errors of the joint surrogate, as far as they are not known, and of the models that know them.
        self.check_names(theta)
        values = parameter_columns({name: np.array([value]) for name, value in theta.items()})
        names = _chosen(values[0, _OF_FLOW:] != NULL_VALUES[_OF_FLOW:])
        finer = self._finer(names)
        if finer is not None:
            return _modes(finer, values, names)
        if not self.domain.contains(*values.T)[0]:
            raise self._outside(theta)
        if not self.joint.domain.contains(*values.T)[0]:
            return np.concatenate([self.outline_modes(**_point(values, (name,))) for name in names])
        weights, left = self._weights(names, values)
        modes = [np.sqrt(left) * _modes(self.joint, values, names)]
        for known, weight in weights.items():
            finer = self._finer(known)
            assert finer is not None, "its error is known"
            if np.abs(weight[0]) > _NOTHING:
                modes.append(weight * _modes(finer, values, known))
        return np.concatenate(modes)

    def added_up(self, theta: Mapping[str, ArrayLike]) -> Booleans:
        # Where several parameters differ and the joint surrogate does not hold.
        values = parameter_columns(theta)
        several = np.count_nonzero(values[:, _OF_FLOW:] != NULL_VALUES[_OF_FLOW:], axis=1) > 1
        return np.asarray(several & ~self.joint.domain.contains(*values.T))

    def _finer(self, names: Names) -> ForwardModel | None:
        """Return the finer model of membranes that differ in these parameters; None if there is none."""
        if not names:
            return self.base
        return self.base.joined(self._databases[names]) if names in self._databases else None

    def _predicted(self, names: Names, values: Floats, outline: bool) -> Prediction:
        """Predict membranes with parameters (n, 6) that differ in the named ones."""
        finer = self._finer(names)
        if finer is not None:
            return finer(_theta(values, names), outline=outline)
        seen = self.joint(_theta(values, names), outline=outline)
        weights, left = self._weights(names, values)
        table, covariance = _table(seen), left[:, None, None] * seen.covariance
        for known, weight in weights.items():
            rows = np.flatnonzero(np.abs(weight) > _NOTHING)
            if len(rows):
                fine = self._predicted(known, values[rows], outline)
                coarse = self.joint(_theta(values[rows], known), outline=outline)
                table[rows] += weight[rows, None] * (_table(fine) - _table(coarse))
                covariance[rows] += weight[rows, None, None] ** 2 * fine.covariance
        apart = np.flatnonzero(~seen.inside)
        if len(apart) and len(names) > 1:
            table[apart], covariance[apart] = self._added_up(names, values[apart], outline)
        return _prediction(table, covariance, seen.outline)

    def _added_up(self, names: Names, values: Floats, outline: bool) -> tuple[Floats, Floats]:
        """Return numbers (n, k) and covariances (n, 3, 3) with the changes that each parameter makes alone added up."""
        plain = self.base(_theta(values, ()), outline=outline)
        alone = [self._predicted((name,), values, outline) for name in names]
        table = sum((_table(each) - _table(plain) for each in alone), _table(plain))
        return table, np.sum([each.covariance for each in alone], axis=0)

    def _weights(self, names: Names, values: Floats) -> tuple[dict[Names, Floats], Floats]:
        """Return the weights (n,) of the known errors of the joint surrogate, and the share (n,) of variance left."""
        # An error is known where the finer model and the joint one hold.
        away = {name: self.joint.distances_from_plain(name, _column(values, name)) for name in names}
        total = np.sum(list(away.values()), axis=0)
        weights: dict[Names, Floats] = {}
        of_plain, left = np.exp(-total), 1.0 - np.exp(-2.0 * total)
        for name, distance in away.items():
            if self._finer((name,)) is not None:
                near = np.exp(distance - total)
                weights[(name,)] = np.where(self._is_known((name,), values, near), near, 0.0)
                of_plain -= weights[(name,)] * np.exp(-distance)
                left -= weights[(name,)] ** 2 * (1.0 - np.exp(-2.0 * distance))
        known = self._is_known((), values, of_plain)
        return weights | {(): np.where(known, of_plain, 0.0)}, np.where(known, left, left + np.exp(-2.0 * total))

    def _is_known(self, names: Names, values: Floats, weight: Floats) -> Booleans:
        """Return where both the finer model and the joint one hold, or where this does not matter."""
        known, rows = np.ones(len(weight), dtype=np.bool_), np.flatnonzero(np.abs(weight) > _NOTHING)
        if len(rows):
            finer, there = self._finer(names), _theta(values[rows], names)
            assert finer is not None, "asked for what is known"
            inside = finer.domain.contains(*there.values())
            known[rows] = inside & self.joint.domain.contains(*parameter_columns(there).T)
        return known


@dataclass(frozen=True, eq=False)
class _CorrectedDomain(Domain):
    """Points where a corrected surrogate has an answer."""

    model: CorrectedMembrane

    @property
    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        both = zip(self.model.base.domain.bounds, self.model.joint.domain.bounds, strict=True)
        ca, size = ((min(one[0], other[0]), max(one[1], other[1])) for one, other in both)
        return ca, size

    def contains(self, capillary_number: ArrayLike, size_ratio: ArrayLike, *coordinates: ArrayLike) -> Booleans:
        columns = aligned(capillary_number, size_ratio, *coordinates)
        return self.model(dict(zip(FREE_PARAMETERS, columns, strict=False))).inside

    def at(self, values: Mapping[str, float]) -> Domain:
        return FixedMembraneDomain(self, dict(values))


def _chosen(differ: Booleans) -> Names:
    return tuple(name for name, different in zip(OF_THE_MEMBRANE, differ, strict=True) if different)


def _column(values: Floats, name: str) -> Floats:
    return values[:, FREE_PARAMETERS.index(name)]


def _theta(values: Floats, names: Names) -> dict[str, Floats]:
    return {name: _column(values, name) for name in (*FREE_PARAMETERS[:_OF_FLOW], *names)}


def _point(values: Floats, names: Names) -> dict[str, float]:
    return {name: float(column[0]) for name, column in _theta(values, names).items()}


def _modes(model: ForwardModel, values: Floats, names: Names) -> Floats:
    modes = model.outline_modes(**_point(values, names))
    assert modes is not None, "a surrogate states its error"
    return modes


def _table(prediction: Prediction) -> Floats:
    """Return all numbers of a prediction but its covariance : (n, k) array."""
    numbers = np.stack([getattr(prediction, name) for name in NUMBERS], axis=1)
    if prediction.outline is None:
        return numbers
    return np.concatenate([numbers, prediction.outline.reshape(len(numbers), -1)], axis=1)


def _prediction(table: Floats, covariance: Floats, outlines: Floats | None) -> Prediction:
    """Return the prediction of `_table`, with outlines of the shape of given ones."""
    inside: Booleans = np.asarray(np.isfinite(table).all(axis=1) & np.isfinite(covariance).all(axis=(1, 2)))
    table, covariance = np.where(inside[:, None], table, np.nan), np.where(inside[:, None, None], covariance, np.nan)
    numbers = dict(zip(NUMBERS, table.T, strict=False))
    shapes = None if outlines is None else table[:, len(NUMBERS) :].reshape(outlines.shape)
    return Prediction(**numbers, covariance=covariance, inside=inside, outline=shapes)
