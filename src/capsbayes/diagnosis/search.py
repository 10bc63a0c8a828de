"""The search for the effect that explains a disagreement."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pandas as pd

from capsbayes.arrays import Floats
from capsbayes.diagnosis.finding import Deviation, Pair, score_jointly
from capsbayes.diagnosis.fits import Fits
from capsbayes.diagnosis.odds import Change, Explanation, Names
from capsbayes.diagnosis.scores import Discrepancy, Measured, Trial
from capsbayes.diagnosis.session import Session, Whitening
from capsbayes.footing import Footing
from capsbayes.infer.outline import aligned_with
from capsbayes.model import Effect, FixedParameters, ForwardModel

# Comparison of the capsules of a session with the best shapes of a model


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
    sizes: Mapping[str, Floats] = field(default_factory=dict, repr=False)  # (n,) of effects, if the capsules differ

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
        return {**self.session.circumstances, **self.sizes, **places}

    @property
    def _metres(self) -> float:
        return self.session.mean("half_width")


def _median(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else float("nan")


# Search for the effect that explains why a session disagrees with a model, or for two effects

LEAST_RATIO = 3.0
"""Log-likelihood ratio below which an effect explains nothing, and log odds from which nothing is no explanation."""

AT_MOST = 5.0
"""Lag in log probability up to which an explanation is in question: odds of 150 to 1."""

_TOGETHER = 4  # effects at most that are measured together with the first
_FAR_BEHIND = 20.0  # in log likelihood, beyond which an effect is not looked at more closely


@dataclass(frozen=True, eq=False)
class Search:
    """Session and model on which the effects are tried."""

    model: ForwardModel
    candidates: Mapping[str, Effect]  # by name of their parameter
    session: Session
    white: Whitening  # made with the model
    without: Fits  # of the model
    measured: Measured
    report: Callable[[str], None]  # called with the name of each effect that is tried
    earlier: Mapping[str, Trial] = field(default_factory=dict)  # of each effect alone, on the same session

    def trials(self) -> dict[str, Trial]:
        """Try every effect alone, the likeliest first; sizes are added where it is not far behind."""
        return _refined(self._tried(self.model, self.without, self.candidates))

    def explanations(self, trials: Mapping[str, Trial]) -> dict[Names, Explanation]:
        """Return what each effect explains alone, those omitted that leave no trace in what is measured."""
        return {
            (name,): self._explanation(trial.scores.evidence, trial.fits)
            for name, trial in trials.items()
            if not trial.unseen
        }

    def pairs(self, trials: Mapping[str, Trial]) -> dict[Names, tuple[Pair, Explanation]]:
        """Try every other effect together with the likeliest, and every other in its place next to the best of them."""
        first = next(iter(trials))
        found = self._with(trials[first], trials)
        pairs = {(first, name): pair for name, pair in found.items()}
        if found:
            second = max(found, key=lambda name: found[name].log_evidence)
            alternatives = self._with(trials[second], {name: trials[name] for name in trials if name != first})
            pairs |= {(name, second): pair.turned for name, pair in alternatives.items()}
        return {names: (pair, self._explanation(pair.log_evidence, pair.fits)) for names, pair in pairs.items()}

    def _with(self, known: Trial, trials: Mapping[str, Trial]) -> dict[str, Pair]:
        """Measure the likeliest few effects together with a known one."""
        scores, name = known.scores, known.effect.parameter.name
        here = FixedParameters(self.model + scores.effect, {name: scores.size})
        others = [other for other, trial in trials.items() if other != name and not trial.unseen]
        tried = _refined(self._tried(here, known.fits, others))
        most = max((trial.scores.log_likelihood_ratio for trial in tried.values()), default=0.0)
        pairs = {}
        for other, trial in list(tried.items())[:_TOGETHER]:
            if trial.scores.log_likelihood_ratio > max(LEAST_RATIO, most - _FAR_BEHIND):
                self.report(f"{scores.effect.name} with {trial.effect.name}")
                pairs[other] = score_jointly(
                    self.model, scores, trial.scores, self.session, self.white, known.fits, self.measured
                )
        return pairs

    def _explanation(self, log_evidence: float, fits: Fits) -> Explanation:
        change = Change.of(self.white, self.without, fits)
        return Explanation(log_evidence, change, Discrepancy.of(self.session, self.white, fits))

    def _tried(self, here: ForwardModel, fits: Fits, names: Iterable[str]) -> dict[str, Trial]:
        """Try effects on top of a model, whose fits are given."""
        trials = {}
        for name in names:
            self.report(self.candidates[name].name)
            known = self.earlier.get(name) if here is self.model else None
            if known is None:
                made = (here, self.candidates[name], self.session, self.white, fits)
                trials[name] = Trial(*made, self.measured.get(name)).explored()
            else:
                trials[name] = known.with_measured(self.measured.get(name))
        return trials


def _refined(trials: Mapping[str, Trial]) -> dict[str, Trial]:
    """Refine those that are not far behind, and return all, the likeliest first."""
    most = max((trial.scores.log_likelihood_ratio for trial in trials.values()), default=0.0)
    for trial in trials.values():
        if trial.scores.log_likelihood_ratio > min(0.5 * most, most - _FAR_BEHIND):
            trial.refine()
    return dict(sorted(trials.items(), key=lambda item: -item[1].scores.log_likelihood_ratio))
