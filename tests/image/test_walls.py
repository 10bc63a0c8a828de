"""Walls found in a picture, and stated ones off its dark lines."""

import numpy as np
import pytest
from drawn import drawn
from drawn_film import bright, film, written

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.image.background import estimate_background, temporal_median, transmission
from capsbayes.image.by_hand import ByHand
from capsbayes.image.files import Picture
from capsbayes.image.film import measure_film
from capsbayes.image.measure import detect, measure
from capsbayes.image.overlay import REAR, overlay
from capsbayes.image.synthetic import Optics
from capsbayes.image.walls import _dark_lines, find_walls
from capsbayes.measurement import Measurement
from capsbayes.quantity import Quantity
from capsbayes.status import Status


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


def test_the_median_of_a_film_is_the_empty_channel():
    places = {"shape": (100, 400), "half_width": 40.0}
    film = [drawn(0.1, 0.8, centre=(x, 49.5), seed=x, **places) for x in (60, 130, 200, 270, 340)]
    median = temporal_median([one.picture for one in film])
    assert np.abs(median - film[0].background).max() < 12.0
    with pytest.raises(InputError, match="at least three frames of one shape, got 2 of shapes"):
        temporal_median([one.picture for one in film[:2]])


def test_a_background_is_guessed_from_the_picture_alone():
    made = drawn(0.1, 0.9, tilt=0.02)
    picture = made.picture.astype(float)
    guessed = estimate_background(picture, find_walls(picture))
    light = transmission(made.background.astype(float), guessed)
    assert np.median(light) == pytest.approx(1.0, abs=0.02)
    assert np.percentile(np.abs(light - 1.0), 90) < 0.04


def test_a_line_is_as_dark_as_three_of_four_strips_are():
    ridge = np.random.default_rng(2).standard_normal((12, 30))
    shifts = np.stack([np.zeros(12), np.arange(12) - 6]).astype(np.int64)
    dark = _dark_lines(ridge, shifts)
    for shift, found in zip(shifts, dark, strict=True):
        for row in range(30):
            at = row + shift
            inside = (at >= 0) & (at < 30)
            values = np.where(inside, ridge[np.arange(12), np.clip(at, 0, 29)], -np.inf)
            assert found[row] == np.sort(values)[3]


def test_a_high_picture_is_measured_as_its_channel_alone():
    made = drawn(0.1, 0.9, tilt=0.02)
    border = ((160, 240), (0, 0))
    high, empty = (np.pad(each, border, mode="edge") for each in (made.picture, made.background))
    alone, within = (
        detect(Picture.from_array(picture), background=Picture.from_array(ground))
        for picture, ground in ((made.picture, made.background), (high, empty))
    )
    assert within.status is Status.DONE
    np.testing.assert_allclose(within.lengths, alone.lengths, atol=1e-6)
    np.testing.assert_allclose(within.outline.points - [0.0, 160.0], alone.outline.points, atol=1e-5)
    rows = within.walls.rows_around(high.shape)
    assert rows.start % 16 == 0
    assert 0 <= within.walls.centre_row - within.walls.half_width - rows.start < 48.0
    assert len(high) > rows.stop > within.walls.centre_row + within.walls.half_width + 20.0


EXPERIMENT = Experiment(cross_section="square", half_width="25.0 +/- 0.1 um", viscosity=0.85)
VELOCITY = Quantity(6e-3, 6e-5, "m/s")
MADE = drawn(0.08, 1.05, half_width=55.0, tilt=0.02)
ROWS, OFF = np.array([99.5 - 55.0, 99.5 + 55.0]), np.array([-6.0, 0.0])


def off_band(*moved, made=MADE, background=True, **stated):
    """How far walls moved by so much are said to lie off their bands."""
    slope = 0.5 * np.tan(made.scene.tilt) * (made.picture.shape[1] - 1)
    x, y = made.scene.middle
    middle = y + np.tan(made.scene.tilt) * (0.5 * (made.picture.shape[1] - 1) - x)
    rows = middle + np.array([-55.0, 55.0]) / np.cos(made.scene.tilt) + moved
    walls = [rows[0] - slope, rows[0] + slope, rows[1] - slope, rows[1] + slope]
    empty = Picture.from_array(made.background) if background else None
    by_hand = ByHand(walls=walls, **stated)
    return detect(Picture.from_array(made.picture), background=empty, by_hand=by_hand).walls


@pytest.mark.parametrize("background", [True, False])
def test_a_wall_six_pixels_outside_its_band_is_warned_of(background):
    walls = off_band(-6.0, 0.0, background=background)
    assert walls.off_band == (pytest.approx(6.0, abs=0.7), 0.0)
    assert walls.doubt.startswith("The upper wall lies")
    assert "px outside the nearest dark line of the picture; if that is the wall, l is" in walls.doubt
    assert float(walls.doubt.split("l is ")[1].split("%")[0]) == pytest.approx(100.0 * 3.0 / 58.0, abs=0.7)
    assert walls.doubt.endswith("smaller.")


def test_walls_off_on_both_sides_are_named_together():
    walls = off_band(6.0, 6.0)
    assert walls.off_band == (pytest.approx(-6.0, abs=0.7), pytest.approx(6.0, abs=0.7))
    assert walls.doubt.startswith("The walls lie 6.")
    assert "inside and" in walls.doubt


def test_walls_on_their_bands_are_not():
    """Nor walls off by less than their stated error allows, nor in a picture that shows no dark line there."""
    assert off_band(0.0, 0.0).doubt == ""
    assert off_band(1.0, -1.0).doubt == ""
    assert off_band(-6.0, 0.0, wall_error=4.0).doubt == ""
    assert (
        off_band(-6.0, 0.0, made=drawn(0.08, 1.05, half_width=55.0, optics=Optics(wall_depth=0.0, outside=1.0))).doubt
        == ""
    )
    assert detect(Picture.from_array(MADE.picture)).walls.doubt == ""


def test_the_warning_is_in_measurement_and_overlay(tmp_path):
    made = drawn(0.08, 1.05, half_width=55.0)
    by_hand = ByHand(walls=ROWS + OFF)
    measured = measure(made.picture, EXPERIMENT, capsule_velocity=VELOCITY, by_hand=by_hand)
    assert measured.status.ok
    measured.write(tmp_path / "measurement.toml")
    again = Measurement.read(tmp_path / "measurement.toml")
    assert again.doubt == measured.doubt != ""
    assert again.doubt in repr(again)
    picture = Picture.from_array(made.picture)

    def orange(walls):
        drawn_over = overlay(picture, detect(picture, by_hand=ByHand(walls=walls)))
        blue, _, red = np.moveaxis(drawn_over[4 * 43 : 4 * 46].astype(int), 2, 0)
        return np.count_nonzero(red - blue > 0.3 * (REAR[2] - REAR[0]))

    assert orange(ROWS + OFF) > 100
    assert orange(ROWS) == 0


def test_the_warning_is_in_the_measurements_of_a_film(tmp_path):
    places = 65.0 + 23.37 * np.arange(4)
    folder, row = written(tmp_path / "film", film(places)), 0.5 * (118 - 1)
    by_hand = ByHand(walls=(row - 51.0, row + 45.0))
    background = bright(x=places[0]).background
    found = measure_film(folder, EXPERIMENT, frame_rate=2000.0, background=background, by_hand=by_hand)
    assert found.capsules[0].measurement.doubt.startswith("The upper wall lies")
