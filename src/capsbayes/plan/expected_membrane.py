"""What a batch is expected to tell of its membrane.

The information of the measurements is the curvature of the likelihood at the membrane that is expected, as the engine
for batches has it, with G_s and a of each capsule and all errors that capsules share integrated out: it compares many
sets of flow rates in little time. The widths of one set are those of the posterior that the same engine samples from
measurements without noise, so that the limits of priors and the curvature of the model count.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from capsbayes.arrays import Floats
from capsbayes.infer.importance.weights import normalised, quasi_random, rows_by_weight
from capsbayes.infer.many.one_membrane.conditional import COMMON, MODULUS, SIZE, Capsules, Start
from capsbayes.infer.many.one_membrane.engine import Draws, MembraneSampling
from capsbayes.infer.many.one_membrane.identify_membrane import drawn_log_moduli
from capsbayes.infer.many.one_membrane.search import Mode
from capsbayes.infer.many.one_membrane.unknowns import Unknowns, key_of

LOGARITHMIC = ("area_dilation_modulus", "bending", "membrane_thickness")
"""Parameters of the membrane of which the width of the logarithm is expected."""

EACH = "surface_shear_modulus_each"
"""Name of the width of G_s of one of the capsules."""

_DRAWS, _DRAWN = 4096, 256  # of a prior, and of the capsules


@dataclass(frozen=True, eq=False)
class ExpectedMembrane:
    """What measurements of a batch tell of a membrane that is expected."""

    capsules: Capsules  # as they would be measured without noise, with the model's own error
    unknowns: Unknowns  # with known spreads
    scores: Floats  # (f,): normal scores of the membrane
    values: Start  # the capsules there
    covariance: Floats  # (4 + f, 4 + f): of what the capsules share and of the scores, priors included

    def log_volume(self, *names: str) -> float:
        """Return the log of the determinant of the covariance of some normal scores; zero if none is unknown."""
        columns = self._columns(*names)
        return float(np.linalg.slogdet(self.covariance[np.ix_(columns, columns)])[1])

    def seeks(self, *names: str) -> bool:
        """Return whether one of some parameters is unknown."""
        return bool(self._columns(*names))

    @property
    def log_modulus_variance(self) -> float:
        """Variance of the mean of ln G_s at known viscosity, by the curvature."""
        return float(self.covariance[MODULUS, MODULUS])

    @property
    def given_membrane(self) -> Floats:
        """Covariance (4, 4) of what is common, were the membrane known."""
        precision = np.linalg.inv(self.covariance)
        return np.asarray(np.linalg.inv(precision[:COMMON, :COMMON]))

    def widths(self) -> dict[str, float]:
        """Return the expected standard deviations by name."""
        # Those of ``surface_shear_modulus`` and ``capsule_radius`` are of the logarithms of the means of the population
        # at known viscosity and half width; that of `EACH` of the logarithm of G_s of one of the capsules; the others
        # of each unknown parameter, of the logarithm of `LOGARITHMIC`.
        mode = Mode(self.scores, self.covariance[COMMON:, COMMON:])
        draws = MembraneSampling(self.capsules, self.unknowns).about(mode, self.values)
        weights = normalised(draws.averaged.log_weights)
        common, given = draws.found.common, self.given_membrane
        shown = shown_parameters(self.unknowns, draws.points)
        columns = np.column_stack([common[:, MODULUS], common[:, SIZE], *shown.values()])
        variances = weights @ (columns - weights @ columns) ** 2
        variances[:2] += given[[MODULUS, SIZE], [MODULUS, SIZE]]
        sds = dict(zip(("surface_shear_modulus", "capsule_radius", *shown), np.sqrt(variances).tolist(), strict=True))
        sds["capsule_radius"] /= float(self.values.common[0, SIZE])
        return {EACH: self._sd_of_each(draws, weights), **sds}

    def _sd_of_each(self, draws: Draws, weights: Floats) -> float:
        """Return the standard deviation of ln G_s of a capsule, root mean square over the capsules."""
        rng = np.random.default_rng(0)
        rows = rows_by_weight(weights, rng, _DRAWN)
        membranes, spreads = self.unknowns.membranes(draws.points[rows]), self.unknowns.spreads_at(draws.points[rows])
        start = Start(draws.found.own[rows], draws.found.common[rows])
        there = self.capsules.at(membranes, spreads, start=start, rng=rng)
        log_ratio = self.capsules.shapes(membranes, there.own).log_ratio
        logs = drawn_log_moduli(self.capsules, there.own, log_ratio, there.common, spreads.modulus, rng)
        return float(np.sqrt(np.mean(np.var(logs, axis=0))))

    def _columns(self, *names: str) -> list[int]:
        return [COMMON + k for k, one in enumerate(self.unknowns.coordinates) if key_of(one) in names]


def prior_widths(unknowns: Unknowns) -> dict[str, float]:
    """Return the standard deviations of the unknown parameters under their priors, of `LOGARITHMIC` by logarithms."""
    if not unknowns.scores:
        return {}
    points = ndtri(quasi_random(unknowns.scores, _DRAWS, 0))
    return {name: float(np.std(values)) for name, values in shown_parameters(unknowns, points).items()}


def shown_parameters(unknowns: Unknowns, points: Floats) -> dict[str, Floats]:
    """Return the unknown parameters at points (d, p) as widths of them are stated : (d,) arrays by name."""
    membranes = unknowns.membranes(points)
    names = [key_of(one) for one in unknowns.coordinates]
    return {name: np.log(membranes[name]) if name in LOGARITHMIC else membranes[name] for name in names}
