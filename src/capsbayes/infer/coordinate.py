"""The further coordinate of a forward model: a nuisance parameter with a prior of its own."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from capsbayes.arrays import Floats
from capsbayes.errors import InputError
from capsbayes.infer.prior import Prior
from capsbayes.model import ForwardModel
from capsbayes.quantity import Quantity

_LEAST_COVERED = 0.8  # of a prior's mass by the range of the model


@dataclass(frozen=True, eq=False)
class Coordinate:
    """A coordinate and its prior, cut to the range of the model.

    Parameters
    ----------
    name : str
        As in `capsbayes.parameters`.
    distribution : Quantity
        Before the cut.
    low, high : float
        Range of the model.

    Examples
    --------
    >>> alpha = Coordinate("pre_inflation", Quantity.uniform(0.0, 0.1), 0.0, 0.1)
    >>> alpha.values([0.25, 0.5]).round(6).tolist(), alpha.log_density(0.2).item()
    ([0.025, 0.05], -inf)
    """

    name: str
    distribution: Quantity
    low: float
    high: float

    @classmethod
    def of(cls, model: ForwardModel, prior: Prior) -> Coordinate | None:
        """Return the coordinate of a model, None if it has none; its prior is by default uniform over the whole range.

        Raises
        ------
        InputError
            If the prior is of a name that is no coordinate of the model or reaches far beyond the range of the model,
            or if the model has several further coordinates.
        """
        check_coordinates(model, prior)
        names = tuple(model.coordinates)
        if len(names) > 1:
            advice = "fix the others: model.fixed(name=value)"
            raise InputError("identify", "model", "one further coordinate at most", ", ".join(names), advice)
        if not names:
            return None
        name = names[0]
        low, high, _ = model.coordinates[name]
        if name not in prior.coordinates:
            return cls(name, Quantity.uniform(low, high), low, high)
        made = cls(name, prior.coordinates[name], low, high)
        if made.covered < _LEAST_COVERED:
            expected = f"a distribution within the range of the model, {low:g} to {high:g}"
            raise InputError("prior", name, expected, f"one with {made.covered:.0%} of its mass there")
        return made

    @cached_property
    def covered(self) -> float:
        """Probability of the range under the distribution."""
        return float(self.distribution.cdf(self.high) - self.distribution.cdf(self.low))

    def values(self, shares: ArrayLike) -> Floats:
        """Return the values below which given shares of the prior lie."""
        shares = self.distribution.cdf(self.low) + np.asarray(shares) * self.covered
        return np.clip(self.distribution.ppf(shares), self.low, self.high)

    def log_density(self, values: ArrayLike) -> Floats:
        """Return the log of the prior density, -inf beyond the range."""
        values = np.asarray(values, dtype=np.float64)
        within = (values >= self.low) & (values <= self.high)
        return np.where(within, self.distribution.logpdf(values) - np.log(self.covered), -np.inf)


def check_coordinates(model: ForwardModel, prior: Prior) -> None:
    """Refuse a prior of a name that is no coordinate of the model, naming those that are.

    Raises
    ------
    InputError
    """
    names = tuple(model.coordinates)
    for other in prior.coordinates:
        if other not in names:
            known = f"a coordinate of {model.name}" + (f" ({', '.join(names)})" if names else "")
            raise InputError("prior", other, known, f"a model of ({', '.join(('Ca', 'a/l', *names))})")
