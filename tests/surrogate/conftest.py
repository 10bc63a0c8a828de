import manufactured
import pytest

from capsbayes.database import Database
from capsbayes.surrogate import Surrogate


@pytest.fixture(scope="session")
def manufactured_database() -> Database:
    return manufactured.database(failed=(5,), mesh_error=manufactured.MESH_ERROR)


@pytest.fixture(scope="session")
def manufactured_surrogate(manufactured_database) -> Surrogate:
    return Surrogate(manufactured_database)
