import numpy as np
import pytest
from drawn import drawn

from capsbayes.errors import InputError
from capsbayes.image.background import estimate_background, temporal_median, transmission
from capsbayes.image.files import Picture
from capsbayes.image.measure import detect
from capsbayes.image.synthetic import Optics
from capsbayes.image.walls import _dark_lines, find_walls
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
