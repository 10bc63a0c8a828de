import pytest

from capsbayes.surrogate import Surrogate


@pytest.fixture(scope="session")
def model():
    return Surrogate.open("square-neo-hookean")
