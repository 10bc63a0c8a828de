"""The empty channel and its walls, and contrast and smoothing as seen against it."""

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
from capsbayes.image.background import Blob, edge_shift, estimate_background, temporal_median, transmission
from capsbayes.image.film import measure_film
from capsbayes.image.walls import WallLines, _dark_lines, find_walls
from capsbayes.status import Status
from evidence.synthetic import Optics, Scene, draw

UNEVEN = Optics(blur=1.0, motion=1.5, halo=0.2, vignetting=0.25, unevenness=0.1, electrons=5000)
FAINT = Optics(band_depth=0.3, interior=0.05, halo=0.1, electrons=20_000)
EXPERIMENT = Experiment(cross_section="square", half_width=25e-6, viscosity=0.85)
MADE = drawn(0.08, 1.05, half_width=55.0)


def seen(picture, background=None, **stated):
    empty = None if background is None else Picture.from_array(background)
    return detect(Picture.from_array(picture), background=empty, by_hand=ByHand(**stated))


@pytest.mark.parametrize("tilt", [-0.06, 0.0, 0.02])
@pytest.mark.parametrize("half_width", [50.3, 68.0])
def test_the_half_width_is_found_to_a_tenth_of_a_pixel(tilt, half_width):
    made = drawn(0.1, 0.9, tilt=tilt, half_width=half_width, optics=Optics(vignetting=0.2, unevenness=0.1))
    for picture in (made.background, made.picture):
        walls = find_walls(picture.astype(float))
        assert walls.half_width == pytest.approx(half_width, abs=0.12)
        assert 0.0 < walls.half_width_error < 0.12
        assert walls.tilt == pytest.approx(tilt, abs=1e-3)
        assert walls.centre_row == pytest.approx(99.5, abs=0.2)


def test_no_walls_are_found_where_there_are_none():
    made = drawn(0.1, 0.9, optics=Optics(wall_depth=0.0, outside=1.0))
    assert find_walls(made.background.astype(float)) is None
    assert find_walls(np.full((200, 200), 100.0)) is None


@pytest.mark.parametrize("half_width", [12.0, 20.0])
@pytest.mark.parametrize("background", [True, False])
def test_a_narrow_channel_is_found_in_a_tall_picture(half_width, background):
    """Unless it shows further lines like its walls."""
    thin = Optics(band_width=1.5, rear_width=1.0, wall_width=1.5)
    made = drawn(0.08, 1.05, half_width=half_width, shape=(320, 200), optics=thin)
    found = seen(made.picture, made.background if background else None)
    assert found.status is Status.DONE
    assert found.lengths[3] == pytest.approx(half_width, abs=0.2)
    assert abs(found.lengths[0] - made.axial_extent) < 2.0 * np.sqrt(found.covariance[0, 0])
    third = round(159.5 + 3.0 * half_width) + np.arange(-4, 5)
    several = made.background.astype(float)
    several[third] = several[round(159.5 + half_width) + np.arange(-4, 5)]
    assert find_walls(several) is None


def test_a_line_is_as_dark_as_three_of_four_strips_are():
    ridge, strips = np.random.default_rng(2).standard_normal((12, 30)), np.arange(12)
    shifts = np.stack([np.zeros(12), strips - 6]).astype(np.int64)
    for shift, dark in zip(shifts, _dark_lines(ridge, shifts), strict=True):
        at = np.arange(30)[:, None] + shift
        values = np.where((at >= 0) & (at < 30), ridge[strips, np.clip(at, 0, 29)], -np.inf)
        np.testing.assert_array_equal(dark, np.sort(values, axis=1)[:, 3])


def test_a_high_picture_is_measured_as_its_channel_alone():
    made, border = drawn(0.1, 0.9, tilt=0.02), ((160, 240), (0, 0))
    high, empty = (np.pad(each, border, mode="edge") for each in (made.picture, made.background))
    alone, within = seen(made.picture, made.background), seen(high, empty)
    assert within.status is Status.DONE
    np.testing.assert_allclose(within.lengths, alone.lengths, atol=1e-6)
    np.testing.assert_allclose(within.outline.points - [0.0, 160.0], alone.outline.points, atol=1e-5)
    walls, rows = within.walls, within.walls.rows_around(high.shape)
    assert rows.start % 16 == 0
    assert 0 <= walls.centre_row - walls.half_width - rows.start < 48.0
    assert len(high) > rows.stop > walls.centre_row + walls.half_width + 20.0


def test_the_empty_channel_is_the_median_of_a_film_or_guessed_from_the_picture_alone():
    places = {"shape": (100, 400), "half_width": 40.0}
    frames = [drawn(0.1, 0.8, centre=(x, 49.5), seed=x, **places) for x in (60, 130, 200, 270, 340)]
    median = temporal_median([frame.picture for frame in frames])
    assert np.abs(median - frames[0].background).max() < 12.0
    with pytest.raises(InputError, match="at least three frames of one shape, got 2 of shapes"):
        temporal_median([frame.picture for frame in frames[:2]])
    made = drawn(0.1, 0.9, tilt=0.02)
    picture = made.picture.astype(float)
    light = transmission(made.background.astype(float), estimate_background(picture, find_walls(picture)))
    assert np.median(light) == pytest.approx(1.0, abs=0.02)
    assert np.percentile(np.abs(light - 1.0), 90) < 0.04


@pytest.mark.parametrize("optics", [Optics(), Optics(blur=2.0, halo=0.05), UNEVEN, FAINT])
@pytest.mark.parametrize("background", [True, False])
@pytest.mark.parametrize("capsule", [(0.08, 1.05), (0.03, 0.75)])
def test_an_inverted_picture_has_the_lengths_of_the_picture(optics, background, capsule):
    made = drawn(*capsule, optics=optics, half_width=55.0, tilt=0.02, centre=(101.2, 98.9))
    plain = seen(made.picture, made.background if background else None)
    inverted = seen(255 - made.picture, 255 - made.background if background else None)
    assert plain.status is inverted.status is Status.DONE
    errors = np.sqrt(np.diag(plain.covariance))
    assert np.all(np.isnan(plain.lengths) == np.isnan(inverted.lengths))
    known = np.isfinite(plain.lengths)
    assert np.all(np.abs(plain.lengths - inverted.lengths)[known] < 2.0 * errors[known])
    assert plain.walls.half_width == pytest.approx(inverted.walls.half_width, abs=0.1)


def test_the_contrast_may_be_stated():
    assert seen(MADE.picture, contrast="dark").status is Status.DONE
    assert not seen(MADE.picture, contrast="bright").status.ok
    assert seen(255 - MADE.picture, contrast="bright").status is Status.DONE


@pytest.mark.parametrize("ground", [0.0, 8.0])
def test_a_glowing_membrane_is_measured_with_the_size_of_a_pixel(ground):
    """It glows on a dark ground, its light decaying inwards as that of a shell seen from the side."""
    bare = replace(Optics(), blur=0.0, electrons=1e8, wall_depth=0.0, outside=1.0, band_depth=0.9, interior=0.3)
    made = draw(Scene(circle(0.8), circle(0.8), half_width=HALF_WIDTH, shape=(200, 220)), bare, seed=1)
    light = gaussian_filter(200.0 - made.picture.astype(float), 1.2) / 180.0
    grey = np.random.default_rng(3).poisson(4.0 * (ground + 180.0 * light)) / 4.0
    picture = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
    assert seen(picture).status is Status.NO_WALLS
    stated = ByHand(pixel_size="0.5 +/- 0.005 um")
    glowing = detect(Picture.from_array(picture), by_hand=stated, half_width=0.5e-6 * HALF_WIDTH)
    assert glowing.status is Status.DONE
    assert glowing.lengths[0] == pytest.approx(made.axial_extent, abs=0.6)
    radius = np.hypot(*(glowing.outline.points - made.scene.middle).T)
    assert radius.mean() == pytest.approx(0.8 * HALF_WIDTH, abs=0.3)


def test_light_gathered_in_the_middle_does_not_make_a_dark_capsule_bright():
    y, x = np.indices(MADE.picture.shape)
    spot = 60.0 * np.exp(-0.5 * (np.hypot(x - 99.5, y - 99.5) / 8.0) ** 2)
    lens = seen(np.clip(MADE.picture + spot * (MADE.background > 100), 0, 254).astype(np.uint8), MADE.background)
    assert lens.status is Status.DONE
    assert lens.lengths[0] == pytest.approx(MADE.axial_extent, abs=0.3)


@pytest.mark.parametrize("background", [True, False])
def test_a_film_of_bright_capsules(tmp_path, background):
    frames = film(65.0 + 23.37 * np.arange(5) if background else np.linspace(-40.0, 370.0, 60))
    empty, capsules = bright(x=65.0).background, []
    for name, inverted in (("dark", False), ("bright", True)):
        folder = written(tmp_path / name, [255 - frame if inverted else frame for frame in frames])
        given = (255 - empty if inverted else empty) if background else None
        made = measure_film(folder, EXPERIMENT, frame_rate=2000.0, background=given, flow="right")
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
def test_the_shift_grows_with_the_side_of_a_median_filter_and_other_filters_are_seen_too(noise):
    filtered = [shift(cv2.medianBlur(levels(noise), side)) for side in (3, 5, 7)]
    assert 0.04 < filtered[0] < 0.2
    assert filtered[0] < 0.6 * filtered[1] < 0.6 * filtered[2] * 1.2
    assert 0.1 < filtered[1] < 0.5
    assert shift(cv2.GaussianBlur(levels(4.0), (0, 0), 1.0)) > 0.03


def test_a_compressed_picture_has_blocks_that_begin_anywhere_and_a_smaller_shift():
    assert 0.01 < shift(compressed(levels(), 90)) < 0.06
    assert 0.03 < shift(compressed(levels(), 60)) <= 0.1
    assert shift(compressed(levels(), 30)) == pytest.approx(0.1)
    grey = compressed(np.pad(levels(), 8, mode="reflect"), 75)
    for down, right in ((3, 0), (0, 5), (1, 7)):
        assert shift(grey[8 - down :, 8 - right :][: SHAPE[0], : SHAPE[1]]) <= 0.08


def test_specks_on_the_lens_no_noise_and_no_room_around_the_capsule_are_no_smoothing():
    grey = levels()
    for row, column in ((20, 20), (70, 200), (40, 60)):
        cv2.circle(grey, (column, row), 4, 120, -1)
    assert shift(grey) == 0.0
    assert edge_shift(np.ones(SHAPE), WALLS, [BLOB]) == 0.0
    everywhere = Blob(np.array([[0.0, 0.0], [239.0, 0.0], [239.0, 119.0], [0.0, 119.0]]), 1.0)
    assert shift(cv2.medianBlur(levels(), 5), [everywhere]) == 0.0
