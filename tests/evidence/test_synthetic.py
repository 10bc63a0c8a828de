import numpy as np
import pytest
from drawn import HALF_WIDTH, circle, drawn, shapes

from evidence.synthetic import Optics, Scene, draw

QUIET = Optics(electrons=1e9, band_depth=1.0, interior=1.0, rear_depth=0.0, blur=0.0, wall_depth=0.0, outside=1.0)


def test_a_black_disc_takes_the_light_of_its_area():
    """The area is exact to a thousandth: no outline is rounded to pixels."""
    disc = circle(0.8)
    picture = draw(Scene(disc, disc, half_width=80.3), QUIET, seed=0).picture.astype(float)
    dark = np.sum(1.0 - picture / QUIET.full_light)
    assert dark == pytest.approx(np.pi * (0.8 * 80.3) ** 2, rel=1e-3)


@pytest.mark.parametrize("shift", [0.0, 0.21, 0.5, 0.83])
def test_an_edge_lies_where_it_should_to_a_hundredth_of_a_pixel(shift):
    disc = circle(0.8)
    centre = (99.5 + shift, 99.5)
    picture = draw(Scene(disc, disc, half_width=80.0, centre=centre), QUIET, seed=0).picture.astype(float)
    row = 0.5 * (picture[99] + picture[100])  # its two middle rows are half a pixel off the longest chord
    chord = np.sum(1.0 - row / QUIET.full_light)
    assert chord == pytest.approx(2.0 * np.sqrt(64.0**2 - 0.5**2), abs=0.02)
    assert np.sum(np.arange(200) * (1.0 - row / QUIET.full_light)) / chord == pytest.approx(centre[0], abs=0.01)


def test_the_truth_is_that_of_the_database():
    made = drawn(0.1, 0.9)
    cases = shapes()
    row = np.argmin(np.abs(HALF_WIDTH * cases["axial_length"] - made.axial_length))
    assert made.axial_extent == pytest.approx(HALF_WIDTH * cases["axial_extent"][row], abs=0.2)
    assert np.ptp(made.outline[:, 0]) == pytest.approx(made.axial_extent)


def test_the_rear_is_drawn_where_it_is_concave_only():
    sharp = Optics(electrons=1e7)
    without = Optics(electrons=1e7, rear_depth=0.0)
    parachute = [drawn(0.1, 1.0, optics=optics).picture.astype(int) for optics in (sharp, without)]
    assert np.min(parachute[0] - parachute[1]) < -40
    disc = circle(0.7)
    round_ = [draw(Scene(disc, disc, half_width=60.0), optics, seed=1).picture for optics in (sharp, without)]
    # of a sphere, the two furthest points of the rear are neighbours: nothing lies between them
    assert np.mean(round_[0] != round_[1]) < 0.01


@pytest.mark.parametrize(
    ("change", "seen"),
    [
        ({"blur": 3.0}, lambda picture: np.abs(np.diff(picture.astype(float), axis=1)).max()),
        ({"motion": 6.0}, lambda picture: np.abs(np.diff(picture.astype(float), axis=1)).max()),
        ({"vignetting": 0.4}, lambda picture: picture[:10, :10].mean()),
        ({"unevenness": 0.2}, lambda picture: picture[:, :20].mean()),
        ({"electrons": 1e7}, lambda picture: picture[60:140, :20].std()),
        ({"interior": 0.4}, lambda picture: picture[80:120, 90:120].mean()),
    ],
)
def test_each_effect_takes_something_away(change, seen):
    assert seen(drawn(0.1, 0.9, optics=Optics(**change)).picture) < 0.97 * seen(drawn(0.1, 0.9).picture)


def test_a_halo_is_brighter_than_the_channel():
    bright = drawn(0.1, 0.9, optics=Optics(halo=0.2, electrons=1e7)).picture
    assert bright.max() > drawn(0.1, 0.9, optics=Optics(electrons=1e7)).picture.max() + 10


def test_tilt_and_flow_move_the_capsule_not_its_lengths():
    plain, turned = drawn(0.1, 0.9), drawn(0.1, 0.9, tilt=0.05, flow=-1)
    assert turned.axial_extent == plain.axial_extent
    assert np.mean(turned.picture != plain.picture) > 0.2


def test_the_seed_decides_the_noise():
    first, again, other = (drawn(0.1, 0.9, seed=seed).picture for seed in (3, 3, 4))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
