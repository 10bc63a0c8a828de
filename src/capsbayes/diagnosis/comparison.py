"""Comparison of the capsules of a session with the best shapes of a model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pandas as pd

from capsbayes.arrays import Floats
from capsbayes.diagnosis.finding import Deviation
from capsbayes.diagnosis.fits import Fits
from capsbayes.diagnosis.session import Session
from capsbayes.infer.outline.likelihood import aligned_with
from capsbayes.infer.outline.normal_distance import Footing
from capsbayes.model import ForwardModel


@dataclass(frozen=True, eq=False)
class AlongOutline:
    """Mean displacement of the measured edges along the outline."""

    outline: Floats  # (p, 2) [l]: mean of the predicted outlines, closed, from the nose
    displacement: Floats  # (p,) [m]: mean normal distance of the measured edge, positive outside
    error: Floats  # (p,) [m]: its standard error


@dataclass(frozen=True, eq=False)
class Comparison:
    """Session of n capsules and the fits of a model to it."""

    session: Session = field(repr=False)
    model: ForwardModel = field(repr=False)
    fits: Fits = field(repr=False)

    def table(self) -> pd.DataFrame:
        """Return a row for each capsule, indexed by its source; G_s is NaN where the model has no such shape."""
        columns = {
            "surface_shear_modulus": self.modulus,
            "surface_shear_modulus_error": self.modulus_error,
            "size_ratio": self.fits.size,
            "capsule_velocity": self.session.circumstances["capsule_velocity"],
            "flow_rate": self.session.flow_rates,
        }
        return pd.DataFrame(columns, index=[measurement.source for measurement in self.session.measurements])

    @property
    def modulus(self) -> Floats:
        """Apparent G_s of each capsule : (n,) array [N/m], NaN where the model has no such shape."""
        return np.where(self.fits.settled, np.exp(self.fits.log_modulus), np.nan)

    @property
    def modulus_error(self) -> Floats:
        """Standard error of the apparent G_s : (n,) array [N/m], without the common error of the viscosity."""
        return self.modulus * np.sqrt(self.fits.covariance[:, 0, 0])

    @property
    def median_modulus(self) -> float:
        """Median of the apparent G_s [N/m]; NaN if the model has none of the shapes."""
        return self.fits.median_modulus

    @property
    def modulus_at_flow_rates(self) -> Mapping[float, tuple[int, float]]:
        """Number of capsules and median of their apparent G_s [N/m] by flow rate [m^3/s]."""
        # Empty if fewer than half of the capsules share theirs with another, as where a sensor has measured it.
        rates = self.session.flow_rates
        settings, counts = np.unique(rates[np.isfinite(rates)], return_counts=True)
        if len(settings) < 2 or counts[counts > 1].sum() < 0.5 * len(rates):
            return {}
        rows = {float(setting): rates == setting for setting in settings}
        return {rate: (int(at.sum()), _median(self.modulus[at])) for rate, at in rows.items()}

    @cached_property
    def outlines(self) -> Floats:
        """Predicted outlines of the best shapes : (n, p, 2) array [l], NaN where the model has none."""
        outlines = self.model(self._theta, outline=True).outline
        assert outlines is not None, "asked for"
        return np.where(self.fits.settled[:, None, None], outlines, np.nan)

    @property
    def added_up(self) -> int:
        """Number of capsules at whose best shape effects of the membrane are added up, not simulated together."""
        return int(np.count_nonzero(self.model.added_up(self._theta) & self.fits.settled))

    @cached_property
    def edges(self) -> Mapping[int, tuple[Floats, Footing]]:
        """Measured points (m, 2) [l] shifted and turned onto the predicted outline, and their feet on it, by row."""
        # There are those of the capsules that have an outline and a best shape.
        return {
            row: aligned_with(measurement.outline.points, self.outlines[row])
            for row, measurement in enumerate(self.session.measurements)
            if self.fits.settled[row] and measurement.outline is not None
        }

    @property
    def gap(self) -> float:
        """Root mean square normal distance of measured and predicted edges [m]; NaN without outlines."""
        return self.gap_of(self.edges)

    def gap_of(self, rows: Iterable[int]) -> float:
        """Return the root mean square normal distance of edges [m] over some of the capsules."""
        distances = [self.edges[row][1].distance for row in rows]
        return self._metres * float(np.sqrt(np.mean(np.square(np.concatenate(distances))))) if distances else np.nan

    @cached_property
    def along_outline(self) -> AlongOutline | None:
        """Mean distance along the outline; None for fewer than two outlines."""
        if len(self.edges) < 2:
            return None
        count = self.outlines.shape[1]
        vertices = np.arange(count)
        distances = np.array(
            [np.interp(vertices, feet.place, feet.distance, period=count) for _, feet in self.edges.values()]
        )
        error = distances.std(axis=0, ddof=1) / np.sqrt(len(distances))
        middle = self.outlines[list(self.edges)].mean(axis=0)
        return AlongOutline(middle, self._metres * distances.mean(axis=0), self._metres * error)

    def trend_line(self, slope: Deviation, places: Floats, at: Floats) -> Floats:
        """Return G_s along a trend of ln G_s, also with the slope less and plus its error : (3, k) array [N/m]."""
        # The line goes through the weighted middle of the settled capsules, at `places` (m,); `at` (k,) are those along
        # it.
        settled = self.fits.settled
        weight = 1.0 / self.fits.covariance[settled, 0, 0]
        middle, height = (np.average(values, weights=weight) for values in (places, self.fits.log_modulus[settled]))
        slopes = slope.size + slope.error * np.array([0.0, -1.0, 1.0])
        return np.asarray(np.exp(height + slopes[:, None] * (at - middle)))

    @property
    def misfit(self) -> Floats:
        """Misfit over degrees of freedom : (n,) array, about one under a right model, NaN without a shape."""
        known = self.fits.known & (self.fits.freedom > 0)
        return np.where(known, self.fits.misfit / np.maximum(self.fits.freedom, 1), np.nan)

    @property
    def outliers(self) -> tuple[str, ...]:
        """Sources of the capsules without a shape of the model: none, one at its border, or a misfit far too large."""
        return tuple(self.session.measurements[int(row)].source for row in np.flatnonzero(self.fits.ill))

    @property
    def _theta(self) -> dict[str, Floats]:
        """Best shapes and circumstances : dict of (n,) array."""
        places = {"capillary_number": np.exp(self.fits.theta[:, 0]), "size_ratio": self.fits.theta[:, 1]}
        return {**self.session.circumstances, **places}

    @property
    def _metres(self) -> float:
        return self.session.mean("half_width")


def _median(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")
