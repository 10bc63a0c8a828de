"""Filters and compression are seen in the noise of the empty channel."""

import cv2
import numpy as np
import pytest

from capsbayes.image.background import Blob, edge_shift
from capsbayes.image.walls import WallLines

SHAPE = (120, 240)
WALLS = WallLines(59.5, 119.5, 0.0, 55.0, 0.05, 2.0)
BLOB = Blob(np.array([[90.0, 30.0], [150.0, 30.0], [150.0, 90.0], [90.0, 90.0]]), 3600.0)


def levels(noise=2.0, seed=1):
    """Grey levels of a channel that becomes brighter to the right, with a dark square in it."""
    grey = 180.0 + 0.05 * np.arange(SHAPE[1]) + noise * np.random.default_rng(seed).standard_normal(SHAPE)
    grey[30:91, 90:151] -= 80.0
    return np.rint(grey).astype(np.uint8)


def compressed(grey, quality):
    return cv2.imdecode(cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_GRAYSCALE)


def shift(grey, blobs=(BLOB,)):
    return edge_shift(grey / 180.0, WALLS, list(blobs))


@pytest.mark.parametrize("noise", [0.7, 2.0, 8.0])
def test_a_picture_as_the_camera_took_it_has_no_shift(noise):
    assert shift(levels(noise)) == 0.0


@pytest.mark.parametrize("noise", [1.0, 4.0])
def test_the_shift_grows_with_the_side_of_a_median_filter(noise):
    filtered = [shift(cv2.medianBlur(levels(noise), side)) for side in (3, 5, 7)]
    assert 0.04 < filtered[0] < 0.2
    assert filtered[0] < 0.6 * filtered[1] < 0.6 * filtered[2] * 1.2
    assert 0.1 < filtered[1] < 0.5


def test_another_filter_that_smooths_is_seen_too():
    assert shift(cv2.GaussianBlur(levels(4.0), (0, 0), 1.0)) > 0.03


def test_a_compressed_picture_has_blocks_and_a_smaller_shift():
    assert 0.01 < shift(compressed(levels(), 90)) < 0.06
    assert 0.03 < shift(compressed(levels(), 60)) <= 0.1
    assert shift(compressed(levels(), 30)) == pytest.approx(0.1)


@pytest.mark.parametrize("moved", [(3, 0), (0, 5), (1, 7)])
def test_blocks_are_found_in_a_part_of_a_compressed_picture(moved):
    """As they are cut out, blocks begin anywhere."""
    grey = compressed(np.pad(levels(), 8, mode="reflect"), 75)
    part = grey[8 - moved[0] :, 8 - moved[1] :][: SHAPE[0], : SHAPE[1]]
    assert shift(part) <= 0.08


def test_specks_on_the_lens_are_no_smoothing():
    grey = levels()
    for row, column in ((20, 20), (70, 200), (40, 60)):
        cv2.circle(grey, (column, row), 4, 120, -1)
    assert shift(grey) == 0.0


def test_a_picture_without_noise_or_without_room_around_the_capsule_says_nothing():
    assert edge_shift(np.ones(SHAPE), WALLS, [BLOB]) == 0.0
    everywhere = Blob(np.array([[0.0, 0.0], [239.0, 0.0], [239.0, 119.0], [0.0, 119.0]]), 1.0)
    assert shift(cv2.medianBlur(levels(), 5), [everywhere]) == 0.0
