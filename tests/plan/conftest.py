import pytest
from polynomial_model import PolynomialModel

from capsbayes.experiment import Experiment
from capsbayes.measurement import Measurement
from capsbayes.plan import LabErrors
from capsbayes.quantity import Quantity
from capsbayes.surrogate import Surrogate


@pytest.fixture(scope="session")
def model():
    return PolynomialModel()


@pytest.fixture(scope="session")
def shipped():
    return Surrogate.open("square-neo-hookean")


@pytest.fixture(scope="session")
def experiment():
    return Experiment(cross_section="square", half_width=Quantity(25e-6, 0.2e-6), viscosity=Quantity(0.85, 0.02))


@pytest.fixture(scope="session")
def known():
    """Nothing but the capsule is uncertain."""
    return Experiment(cross_section="square", half_width=25e-6, viscosity=0.85)


@pytest.fixture(scope="session")
def errors():
    return LabErrors(axial_extent=0.02, axial_length=0.02, capsule_velocity=0.01)


@pytest.fixture(scope="session")
def capsule():
    """The paper's lengths, which the manufactured model has at Ca = 0.082, a/l = 0.96."""
    return Measurement(
        axial_extent=2.14,
        axial_extent_error=0.01,
        axial_length=1.81,
        axial_length_error=0.01,
        capsule_velocity=5e-3,
        capsule_velocity_error=5e-5,
    )
