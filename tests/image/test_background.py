"""Contrast and smoothing, seen against the empty channel."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from drawn import HALF_WIDTH, circle, drawn
from drawn_film import bright, film, written
from scipy.ndimage import gaussian_filter

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.image import ByHand, Picture, detect
from capsbayes.image.background import Blob, edge_shift
from capsbayes.image.film import measure_film
from capsbayes.image.synthetic import Optics, Scene, draw
from capsbayes.image.walls import WallLines
from capsbayes.status import Status

UNEVEN = Optics(blur=1.0, motion=1.5, halo=0.2, vignetting=0.25, unevenness=0.1, electrons=5000)
FAINT = Optics(band_depth=0.3, interior=0.05, halo=0.1, electrons=20_000)
EXPERIMENT = Experiment(cross_section="square", half_width=25e-6, viscosity=0.85)


def seen(picture, background=None, **stated):
    empty = None if background is None else Picture.from_array(background)
    return detect(Picture.from_array(picture), background=empty, by_hand=ByHand(**stated))


@pytest.mark.parametrize("optics", [Optics(), Optics(blur=2.0, halo=0.05), UNEVEN, FAINT])
@pytest.mark.parametrize("background", [True, False])
@pytest.mark.parametrize("capsule", [(0.08, 1.05), (0.03, 0.75)])
def test_an_inverted_picture_has_the_lengths_of_the_picture(optics, background, capsule):
    made = drawn(*capsule, optics=optics, half_width=55.0, tilt=0.02, centre=(101.2, 98.9))
    empty = made.background if background else None
    plain = seen(made.picture, empty)
    inverted = seen(255 - made.picture, None if empty is None else 255 - empty)
    assert plain.status is inverted.status is Status.DONE
    errors = np.sqrt(np.diag(plain.covariance))
    assert np.all(np.isnan(plain.lengths) == np.isnan(inverted.lengths))
    known = np.isfinite(plain.lengths)
    assert np.all(np.abs(plain.lengths - inverted.lengths)[known] < 2.0 * errors[known])
    assert plain.walls.half_width == pytest.approx(inverted.walls.half_width, abs=0.1)


def test_the_contrast_may_be_stated():
    made = drawn(0.08, 1.05, half_width=55.0)
    assert seen(made.picture, contrast="dark").status is Status.DONE
    assert not seen(made.picture, contrast="bright").status.ok
    assert seen(255 - made.picture, contrast="bright").status is Status.DONE
    with pytest.raises(InputError, match='contrast: expected "dark" or "bright"'):
        seen(made.picture, contrast="light")


def glowing(outline, *, ground=8.0, peak=180.0, shape=(200, 220), seed=3):
    """A membrane that glows on a dark ground, its light decaying inwards as that of a shell seen from the side."""
    made = draw(
        Scene(outline, outline, half_width=HALF_WIDTH, shape=shape),
        replace(Optics(), blur=0.0, electrons=1e8, wall_depth=0.0, outside=1.0, band_depth=0.9, interior=0.3),
        seed=1,
    )
    light = gaussian_filter(200.0 - made.picture.astype(float), 1.2) / 180.0
    grey = np.random.default_rng(seed).poisson(4.0 * (ground + peak * light)) / 4.0
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8), made


@pytest.mark.parametrize("ground", [0.0, 8.0])
def test_a_glowing_membrane_is_measured_with_the_size_of_a_pixel(ground):
    picture, made = glowing(circle(0.8), ground=ground)
    assert seen(picture).status is Status.NO_WALLS
    stated = ByHand(pixel_size="0.5 +/- 0.005 um")
    found = detect(Picture.from_array(picture), by_hand=stated, half_width=0.5e-6 * HALF_WIDTH)
    assert found.status is Status.DONE
    assert found.lengths[0] == pytest.approx(made.axial_extent, abs=0.6)
    radius = np.hypot(*(found.outline.points - made.scene.middle).T)
    assert radius.mean() == pytest.approx(0.8 * HALF_WIDTH, abs=0.3)


def test_light_gathered_in_the_middle_does_not_make_a_dark_capsule_bright():
    made = drawn(0.08, 1.05, half_width=55.0)
    y, x = np.indices(made.picture.shape)
    spot = 60.0 * np.exp(-0.5 * (np.hypot(x - 99.5, y - 99.5) / 8.0) ** 2)
    lens = np.clip(made.picture + spot * (made.background > 100), 0, 254).astype(np.uint8)
    found = seen(lens, made.background)
    assert found.status is Status.DONE
    assert found.lengths[0] == pytest.approx(made.axial_extent, abs=0.3)


@pytest.mark.parametrize("background", [True, False])
def test_a_film_of_bright_capsules(tmp_path, background):
    places = np.linspace(-40.0, 370.0, 60) if not background else 65.0 + 23.37 * np.arange(5)
    frames = film(places)
    empty = bright(x=places[0]).background if background else None
    capsules = []
    for name, sense in (("dark", 1), ("bright", -1)):
        mirrored = [frame if sense == 1 else 255 - frame for frame in frames]
        given = None if empty is None else empty if sense == 1 else 255 - empty
        made = measure_film(
            written(tmp_path / name, mirrored), EXPERIMENT, frame_rate=2000.0, background=given, flow="right"
        )
        assert made.status is Status.DONE
        capsules.append(made.capsules[0].measurement)
    dark, light = capsules
    assert dark.status is light.status is Status.DONE
    assert light.axial_extent == pytest.approx(dark.axial_extent, abs=2.0 * dark.axial_extent_error)
    assert light.capsule_velocity == pytest.approx(dark.capsule_velocity, rel=2e-3)


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
