"""Stated walls that lie off the dark lines of the picture are warned of."""

import numpy as np
import pytest
from drawn import drawn
from drawn_film import bright, film, written

from capsbayes.experiment import Experiment
from capsbayes.image import ByHand, Picture, detect, measure
from capsbayes.image.film import measure_film
from capsbayes.image.overlay import REAR, overlay
from capsbayes.image.synthetic import Optics
from capsbayes.measurement import Measurement
from capsbayes.quantity import Quantity

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
