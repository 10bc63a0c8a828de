"""Sobol indices of each answer by each input, with the ranges that they hold for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from capsbayes import __version__
from capsbayes.parameters import PARAMETERS
from capsbayes.quantity import Quantity
from capsbayes.status import Status

if TYPE_CHECKING:
    import pandas as pd

CONFIDENCE = 0.95


@dataclass(frozen=True)
class SobolIndex:
    """Indices of one input, each with half of its 95 % confidence interval."""

    first: float  # share of the variance owed to this input alone
    first_error: float
    total: float  # owed to it alone or together with others
    total_error: float


@dataclass(frozen=True, eq=False)
class SobolStudy:
    """First-order and total indices of each answer by each input."""

    ranges: Mapping[str, Quantity]  # over which each input was varied
    indices: Mapping[str, Mapping[str, SobolIndex]]  # by answer (G_s, a, Ca, a/l), then by input
    mean: Mapping[str, float]  # of each answer over the ranges [SI]
    sd: Mapping[str, float]
    samples: int  # number of answers
    outside: int  # how many of them had no exact shape and used the nearest
    change: float  # largest change of an index of G_s or a without groups with such a sample; NaN if too few are left
    groups: int
    seed: int
    notes: tuple[str, ...]
    model_name: str
    model_sha256: str
    status: Status

    def table(self, answer: str = "surface_shear_modulus") -> pd.DataFrame:
        """Return the indices of one answer, a row for each input."""
        import pandas as pd

        return pd.DataFrame.from_dict(
            {name: asdict(index) for name, index in self.indices[answer].items()}, orient="index"
        )

    def as_dict(self) -> dict[str, Any]:
        """Return all fields, ready for JSON."""
        return {
            "status": self.status.name,
            "sentence": str(self.status),
            "ranges": {
                name: {"kind": quantity.shape, **dict(zip(("first", "second"), quantity.parameters, strict=True))}
                for name, quantity in self.ranges.items()
            },
            "indices": {
                answer: {name: asdict(index) for name, index in found.items()} for answer, found in self.indices.items()
            },
            "mean": {name: {"value": value, "unit": PARAMETERS[name].unit} for name, value in self.mean.items()},
            "sd": {name: {"value": value, "unit": PARAMETERS[name].unit} for name, value in self.sd.items()},
            "samples": self.samples,
            "outside": self.outside,
            "largest_change_without_them": None if np.isnan(self.change) else self.change,
            "groups": self.groups,
            "confidence": CONFIDENCE,
            "notes": list(self.notes),
            "model": {"name": self.model_name, "sha256": self.model_sha256},
            "seed": self.seed,
            "version": __version__,
        }
