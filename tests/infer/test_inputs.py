import numpy as np
import pytest
from scipy import stats

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.infer.log_grid import LogGrid
from capsbayes.infer.prior import Inputs
from capsbayes.measurement import Measurement
from capsbayes.quantity import Quantity
from capsbayes.status import Status

DISTRIBUTIONS = {
    "cut normal": (Quantity(2.0, 0.1).distribution, 1e-9),
    "loose cut normal": (Quantity(1.0, 0.5).distribution, 1e-9),
    "normal": (stats.norm(2.0, 0.1), 1e-4),
    "lognormal": (stats.lognorm(0.4, scale=2.0), 1e-3),
    "uniform": (stats.uniform(1.0, 2.0), 1e-3),
    "gamma": (stats.gamma(9.0, scale=0.2), 1e-3),
}


@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_the_log_density_is_that_of_the_distribution(name):
    frozen, tolerance = DISTRIBUTIONS[name]
    one = Quantity.of(frozen)
    values = frozen.ppf(np.linspace(0.01, 0.99, 51))
    difference = one.logpdf(values) - frozen.logpdf(values)
    assert np.ptp(difference) < 1e3 * tolerance * 1e-2
    assert one.logpdf(np.array([-1.0]))[0] == -np.inf


@pytest.mark.parametrize("name", DISTRIBUTIONS)
@pytest.mark.parametrize("power", [-1, 0, 1])
def test_masses_carry_the_power(name, power):
    frozen, _ = DISTRIBUTIONS[name]
    if name == "loose cut normal" and power < 0:
        pytest.skip("its logarithm has no distribution under 1/x")
    masses = LogGrid.of(Quantity.of(frozen), power)
    values = np.exp(masses.logs)
    norm = frozen.expect(lambda x: x**power, lb=max(frozen.support()[0], 1e-12))
    mean = frozen.expect(lambda x: x ** (power + 1), lb=max(frozen.support()[0], 1e-12)) / norm
    assert masses.masses @ values == pytest.approx(mean, rel=2e-3)


def test_a_narrowed_input_keeps_its_mean():
    for frozen in (Quantity(2.0, 0.1).distribution, stats.uniform(1.0, 2.0), stats.gamma(9.0, scale=0.2)):
        wide = Quantity.of(frozen)
        narrow = LogGrid.of(wide.rescaled(wide.value, 0.5))
        values = np.exp(narrow.logs)
        mean = narrow.masses @ values
        assert mean == pytest.approx(frozen.mean(), rel=1e-3)
        assert np.sqrt(narrow.masses @ (values - mean) ** 2) == pytest.approx(0.5 * frozen.std(), rel=5e-3)


def test_a_number_is_known():
    one = Quantity.of(25e-6)
    assert one.known
    assert LogGrid.of(one, 1).marginal().sd == 0.0


def test_a_velocity_that_is_hardly_measured_is_refused():
    seen = Measurement(axial_extent=2.0, axial_extent_error=0.1, capsule_velocity=1e-3, capsule_velocity_error=0.3e-3)
    experiment = Experiment(cross_section="square", half_width=25e-6, viscosity=0.8)
    with pytest.raises(InputError, match=r"capsule_velocity: expected a standard error below 25% .*, got 30%"):
        Inputs.of(seen, experiment)


def test_a_measurement_without_a_result_is_refused_with_its_reason():
    inputs = Inputs.of_experiment(Experiment(cross_section="square", half_width=25e-6, viscosity=0.85))
    with pytest.raises(InputError, match=r"capsule\.png: status: expected .*, got No capsule was found"):
        inputs.with_velocity_of(Measurement.refused(Status.NO_CAPSULE, source="capsule.png"))
