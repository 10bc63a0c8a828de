"""Shapes of the database that comes with the library."""

import pytest

from capsbayes.database import Database


@pytest.fixture(scope="package")
def square_database():
    return Database.open("square-neo-hookean")
