"""Summary of one quantity: mean, standard deviation, median, equal-tailed 68 % and 95 % intervals."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Marginal:
    """Summary of the posterior of one quantity.

    Parameters
    ----------
    mean, sd : float
        Mean and standard deviation.
    median : float
        Half of the probability lies below.
    lower_68, upper_68 : float
        16 % of the probability lies below the one and above the other.
    lower_95, upper_95 : float
        2.5 % of the probability lies below the one and above the other.

    Examples
    --------
    >>> import numpy as np
    >>> marginal = Marginal.of_draws(np.arange(1001.0))
    >>> marginal.median, marginal.lower_68, marginal.upper_95
    (500.0, 160.0, 975.0)
    """

    LEVELS: ClassVar[tuple[float, ...]] = (0.5, 0.16, 0.84, 0.025, 0.975)

    mean: float
    sd: float
    median: float
    lower_68: float
    upper_68: float
    lower_95: float
    upper_95: float

    @classmethod
    def known(cls, value: float) -> Marginal:
        """Return the summary of a number without error."""
        return cls(value, 0.0, value, value, value, value, value)

    @classmethod
    def of_draws(cls, draws: ArrayLike) -> Marginal:
        """Return the summary of equally weighted draws of any shape."""
        flat = np.ravel(draws)
        quantiles = (float(value) for value in np.quantile(flat, cls.LEVELS))
        return cls(float(flat.mean()), float(flat.std()), *quantiles)

    def contains(self, value: float, *, level: int) -> bool:
        """Return whether the 68 % or the 95 % interval holds a value."""
        lower, upper = self.ends(level)
        return lower <= value <= upper

    def ends(self, level: int) -> tuple[float, float]:
        """Return the ends of the 68 % or the 95 % interval."""
        return {68: (self.lower_68, self.upper_68), 95: (self.lower_95, self.upper_95)}[level]

    def as_dict(self) -> dict[str, float]:
        """Return the fields by name, for files."""
        return asdict(self)
