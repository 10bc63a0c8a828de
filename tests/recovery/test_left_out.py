"""Truths the surrogate has never seen: simulated cases left out of its database, measured with noise, found again.

A truth drawn from the surrogate itself would hide the surrogate's own error.
"""

import numpy as np
import pytest
from scipy import stats
from simulated_capsules import measured_capsule

from capsbayes.database import Database
from capsbayes.experiment import Experiment
from capsbayes.infer import Quadrature
from capsbayes.quantity import Quantity
from capsbayes.surrogate import Surrogate

EXPERIMENT = Experiment(cross_section="square", half_width=Quantity(25e-6, 0.25e-6), viscosity=Quantity(0.85, 0.02))
EVERY = 6
TIMES = 10
TRUTHS = ("surface_shear_modulus", "capsule_radius")


@pytest.fixture(scope="module")
def ranks():
    """Posterior probability below the true G_s and a : (2, cases, times) array."""
    cases = Database.open("square-neo-hookean").converged
    out = _inner(cases)[EVERY // 2 :: EVERY]
    keep = np.setdiff1d(np.arange(len(cases)), out)
    engine = Quadrature(Surrogate(Database(cases.dataset.isel(case=keep))), EXPERIMENT)
    rng, found = np.random.default_rng(42), []
    for case in out:
        shape = [cases[name][case] for name in ("axial_extent", "axial_length", "velocity_ratio")]
        theta = cases["capillary_number"][case], cases["size_ratio"][case]
        for _ in range(TIMES):
            capsule = None
            while capsule is None:
                capsule = measured_capsule(EXPERIMENT, shape, theta, rng, (0.01, 0.01), 0.01)
            posterior = engine(capsule.seen)
            found.append([posterior.probability_below(name, getattr(capsule, name)) for name in TRUTHS])
    return np.array(found).T.reshape(2, len(out), TIMES)


def _inner(cases):
    """Cases of the columns of equal a/l that are neither ends of their column nor in the first or last one."""
    ca, size = cases["capillary_number"], np.round(cases["size_ratio"], 6)
    columns, inner = np.unique(size), []
    for column in columns[1:-1]:
        index = np.flatnonzero(size == column)
        inner += list(index[np.argsort(ca[index])][1:-1])
    return np.array(inner)


@pytest.mark.parametrize(("row", "name"), [(0, "G_s"), (1, "a")])
@pytest.mark.parametrize("level", [0.5, 0.9, 0.95])
def test_intervals_hold_truths_the_surrogate_has_never_seen(ranks, row, name, level):
    """Measurements of one case share the surrogate's error there: the band counts cases, not measurements."""
    covered = np.mean(np.abs(ranks[row] - 0.5) <= 0.5 * level)
    cases = ranks.shape[1]
    low, high = (bound / cases for bound in stats.binom.interval(0.999, cases, level))
    assert low <= covered <= high, (name, covered)
