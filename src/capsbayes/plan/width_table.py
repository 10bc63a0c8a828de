"""Table of expected widths over Ca and a/l, for many capsules at once."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from capsbayes.arrays import Floats
from capsbayes.model import ForwardModel
from capsbayes.plan.borders import Borders, range_at
from capsbayes.plan.identifiability import Progress
from capsbayes.plan.widths import Width, WidthPredictor

_POINTS = 32  # along log Ca in each column
_SPACING, _MOST = 0.015, 9  # of the columns, and how many
_TAIL = 0.002  # of the sizes beyond either end of the columns
_BORDERS = 65


@dataclass(frozen=True, eq=False)
class WidthTable:
    """Table of widths: Ca along columns of constant a/l."""

    columns: Floats  # (k,): a/l, rising
    log_ca: Floats  # (k, m): points of each column, from end to end of the model there
    values: dict[str, Floats]  # (k, m): the fields of `Width`
    borders: Borders

    @classmethod
    def of(cls, predictor: WidthPredictor, sizes: Floats, progress: Progress | None = None) -> WidthTable:
        """Compute the table for capsules of given sizes (n,), within the model."""
        model = predictor.model
        columns = _columns(model, sizes)
        ca = np.stack([range_at(model, float(size)).inner(_POINTS) for size in columns])
        places = [(row, column) for row in range(len(columns)) for column in range(_POINTS)]
        shown = places if progress is None else progress(places, len(places), "expected widths")
        values = {name: np.full(ca.shape, np.nan) for name in Width.names()}
        for row, column in shown:
            width = predictor.at(float(ca[row, column]), float(columns[row]))
            for field in fields(width):
                values[field.name][row, column] = getattr(width, field.name)
        return cls(columns, np.log(ca), values, _borders(model, columns))

    def at(self, ca: Floats, size: Floats) -> dict[str, Floats]:
        """Interpolate the widths of capsules linearly in log Ca and a/l : (n,) arrays by name."""
        size = np.clip(size, self.columns[0], self.columns[-1])
        right = np.clip(np.searchsorted(self.columns, size), 1, max(len(self.columns) - 1, 1))
        left = right - 1
        if len(self.columns) == 1:
            left = right = np.zeros(len(size), dtype=np.intp)
        gap = self.columns[right] - self.columns[left]
        share = np.where(gap > 0.0, (size - self.columns[left]) / np.where(gap > 0.0, gap, 1.0), 0.0)
        found = {}
        for name, values in self.values.items():
            by_column = np.stack([_along(np.log(ca), *pair) for pair in zip(self.log_ca, values, strict=True)])
            each = np.arange(len(size))
            found[name] = (1.0 - share) * by_column[left, each] + share * by_column[right, each]
        return found

    def highest(self, size: Floats) -> Floats:
        """Return the highest Ca of the model at sizes : (n,) array."""
        return self.borders.at(size)[1]


def _along(log_ca: Floats, places: Floats, values: Floats) -> Floats:
    known = np.isfinite(values)
    return np.interp(log_ca, places[known], values[known])


def _columns(model: ForwardModel, sizes: Floats) -> Floats:
    """Return columns over the sizes within the model : (k,) array; one if all are of one size."""
    first, last = model.domain.bounds[1]
    low, high = np.clip(np.quantile(sizes, [_TAIL, 1.0 - _TAIL]), first, last)
    if high - low < 1e-9:
        return np.array([low])
    return np.linspace(low, high, int(np.clip(np.ceil((high - low) / _SPACING) + 1, 2, _MOST)))


def _borders(model: ForwardModel, columns: Floats) -> Borders:
    return Borders.of(model, columns if len(columns) == 1 else np.linspace(columns[0], columns[-1], _BORDERS))
