"""A bench that is served, a browser and a picture for the walks through its page."""

import cv2
import pytest
from drawn import drawn


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Folder of a bench that is served, and its address."""
    from walk import served  # which needs playwright

    folder = tmp_path_factory.mktemp("bench") / "capsules"
    with served(folder) as (_, address):
        yield folder, address


@pytest.fixture(scope="module")
def browser():
    from walk import chromium

    with chromium() as opened:
        yield opened


@pytest.fixture
def picture(tmp_path):
    path = tmp_path / "capsule.png"
    cv2.imwrite(str(path), drawn(0.08, 1.05, half_width=55.0).picture)
    return path
