"""Walls, scale and part of a picture as a person states them."""

import numpy as np
import pytest
from drawn import dirty, drawn
from drawn_film import bright, film, written

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.image import ByHand, Picture, detect, measure
from capsbayes.image.film import measure_film
from capsbayes.image.measure import silhouette_of
from capsbayes.image.overlay import overlay
from capsbayes.measurement import Measurement
from capsbayes.quantity import Quantity
from capsbayes.status import Status

EXPERIMENT = Experiment(cross_section="square", half_width="25.0 +/- 0.1 um", viscosity=0.85)
VELOCITY = Quantity(6e-3, 6e-5, "m/s")
SHAPE = (200, 300)


def rows_of_walls(scene):
    """Rows of either wall at the left and the right border."""
    x, y = scene.middle
    apart = scene.half_width / np.cos(scene.tilt)
    axis = y + np.tan(scene.tilt) * (np.array([0.0, scene.shape[1] - 1.0]) - x)
    return [*(axis - apart), *(axis + apart)]


def seen(made, **stated):
    pictures = (Picture.from_array(pixels) for pixels in (made.picture, made.background))
    picture, background = pictures
    return detect(picture, background=background, by_hand=ByHand(**stated), half_width=EXPERIMENT.half_width)


@pytest.mark.parametrize("tilt", [0.0, 0.03, 0.25])
def test_stated_walls_give_the_lengths_of_those_that_are_found(tilt):
    made = drawn(0.08, 1.05, half_width=55.0, shape=(260, 260), tilt=tilt, centre=(126.0, 131.0))
    found = seen(made, walls=rows_of_walls(made.scene), wall_error=0.5)
    assert found.status is Status.DONE
    truth = [made.axial_extent, made.axial_length, made.axial_extent - made.axial_length, made.half_width]
    np.testing.assert_allclose(found.lengths, truth, atol=0.3)
    assert found.walls.tilt == pytest.approx(tilt, abs=1e-6)
    assert found.walls.half_width_error == pytest.approx(0.5 / np.sqrt(2.0), rel=0.05)
    if tilt < 0.1:
        np.testing.assert_allclose(found.lengths, seen(made).lengths, atol=0.05)


def test_a_part_of_the_picture_is_measured_where_it_lies():
    """One of two capsules: its outline is in the pixels of the whole picture."""
    made = drawn(0.1, 0.9, half_width=50.0, shape=SHAPE, centre=(90.0, 99.5))
    second = drawn(0.1, 0.9, half_width=50.0, shape=SHAPE, centre=(220.0, 99.5))
    both = made.picture.copy()
    both[:, 155:] = second.picture[:, 155:]
    picture, background = Picture.from_array(both), Picture.from_array(made.background)
    assert detect(picture, background=background).status is Status.SEVERAL_CAPSULES
    alone = seen(made)
    for stated in ({}, {"walls": rows_of_walls(made.scene)}):
        found = detect(picture, background=background, by_hand=ByHand(crop="8, 10, 150, 180 px", **stated))
        assert found.status is Status.DONE
        np.testing.assert_allclose(found.lengths, alone.lengths, atol=0.1)
        np.testing.assert_allclose(found.outline.points.mean(axis=0), alone.outline.points.mean(axis=0), atol=0.1)
        np.testing.assert_allclose(found.axis, alone.axis, atol=0.1)
        assert found.nose.distance == pytest.approx(alone.nose.distance, abs=0.1)
        assert found.walls.centre_row == pytest.approx(alone.walls.centre_row, abs=0.2)


@pytest.mark.parametrize("background", [True, False])
def test_a_pixel_size_needs_no_walls(background):
    """The picture shows none: the channel is wider than it."""
    made = drawn(0.08, 1.05, half_width=55.0)
    rows = slice(50, 150)
    picture = made.picture[rows]
    empty = made.background[rows] if background else None
    refused = measure(picture, EXPERIMENT, capsule_velocity=VELOCITY, background=empty)
    assert refused.status is Status.NO_WALLS
    assert all(option in str(refused.status) for option in ("--walls", "--pixel-size", "--axis"))
    size = Quantity(25e-6 / 55.0, 0.01 * 25e-6 / 55.0, "m")
    made_by = ByHand(pixel_size=size, axis="49.5 px")
    measured = measure(picture, EXPERIMENT, capsule_velocity=VELOCITY, background=empty, by_hand=made_by)
    truth = np.array([made.axial_extent, made.axial_length]) / 55.0
    np.testing.assert_allclose(measured.lengths, truth, atol=0.015)
    scale = np.hypot(0.01, 0.1 / 25.0)
    assert measured.axial_extent_error / measured.axial_extent == pytest.approx(scale, rel=0.1)
    assert measured.outline.pose.offset > 0.5 * scale


def test_a_measurement_says_that_its_walls_were_stated(tmp_path):
    made = drawn(0.08, 1.05, half_width=55.0)
    walls = ByHand(walls="44.5, 154.5", wall_error="0.5 px")
    measured = measure(made.picture, EXPERIMENT, capsule_velocity=VELOCITY, by_hand=walls)
    assert measured.walls == "walls by hand at rows 44.5, 154.5 px, each +/- 0.5 px"
    measured.write(tmp_path / "m.toml")
    again = Measurement.read(tmp_path / "m.toml")
    assert again.walls == measured.walls
    assert measured.walls in repr(again)
    found = measure(made.picture, EXPERIMENT, capsule_velocity=VELOCITY)
    assert found.walls == ""
    assert "walls" not in found.described()


def test_stated_walls_are_dashed_in_the_overlay():
    made = drawn(0.08, 1.05, half_width=55.0)
    picture = Picture.from_array(made.picture)

    def blue(**stated):
        canvas = overlay(picture, detect(picture, by_hand=ByHand(**stated))).astype(int)
        line = canvas[4 * 44 : 4 * 46]  # rows of the upper wall
        return np.mean(np.any(line[..., 0] - line[..., 2] > 100, axis=0))

    assert blue() > 0.95
    assert 0.4 < blue(walls="44.5, 154.5") < 0.8


def test_a_film_with_stated_walls_or_pixel_size(tmp_path):
    places = 65.0 + 23.37 * np.arange(5)
    written(tmp_path / "film", film(places))
    empty = bright(x=places[0]).background
    row = 0.5 * (118 - 1)
    known = measure_film(tmp_path / "film", EXPERIMENT, frame_rate=2000.0, background=empty).capsules[0].measurement
    size = Quantity(25e-6 / 45.0, 0.002 * 25e-6 / 45.0, "m")
    for stated in ({"walls": (row - 45.0, row + 45.0)}, {"pixel_size": size, "crop": "5, 4, 320, 110"}):
        made = measure_film(
            tmp_path / "film", EXPERIMENT, frame_rate=2000.0, background=empty, by_hand=ByHand(**stated)
        )
        measured = made.capsules[0].measurement
        assert measured.status is Status.DONE
        assert measured.walls
        assert measured.axial_extent == pytest.approx(known.axial_extent, rel=5e-3)
        assert measured.capsule_velocity == pytest.approx(23.37 * size.value * 2000.0, rel=5e-3)
    # the velocity needs the size of a pixel alone, whose error is smaller than that of the half width
    assert measured.capsule_velocity_error < 0.003 * measured.capsule_velocity


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"walls": "12.5"}, 'walls: expected the rows of two walls in px, as "12.5, 187.0"'),
        ({"walls": "12.5 um, 187 um"}, "walls: expected the rows of two walls"),
        ({"walls": (12.5, np.nan)}, "walls: expected the rows of two walls"),
        ({"walls": "20 180, 180 20"}, "two walls that do not cross in the picture, got 20, 180, 180, 20"),
        ({"walls": "20, 20"}, "two walls that do not cross"),
        ({"walls": "20 30, 180 160"}, "two parallel walls, got 160 px apart at the left border and 130 px"),
        ({"walls": "-20, 180"}, "walls: expected rows within the picture, from 0 to 199 px, got -20"),
        ({"walls": "20, 200"}, "rows within the picture"),
        ({"walls": "20, 180", "pixel_size": "0.3 +/- 0.01 um"}, "one of the two"),
        ({"walls": "20, 180", "wall_error": "0"}, "wall error: expected a positive number of px"),
        ({"wall_error": "1 px"}, "got no walls"),
        ({"axis": "99"}, "axis: expected a pixel size with it"),
        ({"axis": "300", "pixel_size": "0.3 +/- 0.01 um"}, "axis: expected rows within the picture"),
        ({"pixel_size": "0.3 um"}, "pixel size: expected a standard error"),
        ({"pixel_size": "0.3 +/- 0.01 s"}, "pixel size: expected"),
        ({"crop": "0, 0, 400, 100"}, "crop: expected a part of the picture of 200 x 200 px, got 0, 0, 400, 100"),
        ({"crop": "-1, 0, 100, 100"}, "a part of the picture"),
        ({"crop": "0, 0, 8, 100"}, "crop: expected at least 16 x 16 px, got 8 x 100 px"),
        ({"crop": "some"}, "crop: expected left column, upper row, width and height in px"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(stated, message):
    blank = Picture.from_array(np.full((200, 200), 100, dtype=np.uint8))
    with pytest.raises(InputError) as caught:
        detect(blank, by_hand=ByHand(**stated), half_width="25 um")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_pixel_size_needs_the_half_width():
    blank = Picture.from_array(np.full((200, 200), 100, dtype=np.uint8))
    with pytest.raises(InputError, match="half width: expected that of the channel"):
        detect(blank, by_hand=ByHand(pixel_size="0.3 +/- 0.01 um"))


CAPSULE = drawn(0.08, 1.05, half_width=55.0)


@pytest.mark.parametrize("place", [0.0, 0.25, 0.5, 0.8])
def test_dirt_on_the_outline_is_erased_and_the_lengths_are_those_without_it(place):
    clean = seen(CAPSULE)
    k = int(place * len(clean.outline.points))
    at = clean.outline.points[k] + 3.0 * clean.outline.normals[k]
    picture, background = Picture.from_array(dirty(CAPSULE, at)), Picture.from_array(CAPSULE.background)
    assert detect(picture, background=background).status is Status.DOUBLET
    found = detect(picture, background=background, by_hand=ByHand(erase=(*(at - 13.0), 26.0, 26.0)))
    assert found.status is Status.DONE
    off = (found.lengths - clean.lengths) / np.sqrt(np.diag(found.covariance))
    assert np.abs(off).max() < 1.0
    erased = found.outline.erased
    assert 10 < erased.sum() < 40
    assert np.abs(found.outline.points[erased] - at).max() < 20.0
    apart = np.hypot(*(found.outline.points[:, None] - clean.outline.points).T).min(axis=0)
    assert apart[~erased].max() < 0.75  # of points 1.25 px apart
    assert np.all(apart[erased] < 0.75 + 2.0 * found.outline.point_error[erased])


def test_erased_stretches_are_no_part_of_the_silhouette_and_are_dotted_in_the_overlay():
    clean = seen(CAPSULE)
    at = clean.outline.points[len(clean.outline.points) // 4]
    found = seen(CAPSULE, erase=f"{at[0] - 10:.0f}, {at[1] - 10:.0f}, 20, 20 px")
    whole, rest = silhouette_of(clean), silhouette_of(found)
    assert len(whole.points) - 9 <= len(rest.points) <= len(whole.points) - 4
    assert rest.noise.scale == pytest.approx(whole.noise.scale, rel=0.2)
    picture = Picture.from_array(CAPSULE.picture)
    drawings = [overlay(picture, one).astype(int) for one in (clean, found)]
    (left, top), size = np.rint(4.0 * (at - 10.0)).astype(int), 80
    red = [one[:, :, 2] - one[:, :, 1] > 90 for one in drawings]
    whole, rest = (np.count_nonzero(one[top : top + size, left : left + size]) for one in red)
    assert 0.1 * whole < rest < 0.6 * whole
    assert np.count_nonzero(red[1]) > 0.8 * np.count_nonzero(red[0])


def test_a_part_and_what_is_erased_in_it_are_in_pixels_of_the_whole_picture():
    clean = seen(CAPSULE)
    at = clean.outline.points[len(clean.outline.points) // 4]
    boxes = [(*(at - 10.0), 20.0, 20.0)]
    whole, part = (seen(CAPSULE, erase=boxes, **how) for how in ({}, {"crop": (10, 8, 180, 180)}))
    assert whole.outline.erased.sum() == pytest.approx(part.outline.erased.sum(), abs=2)
    np.testing.assert_allclose(part.lengths, whole.lengths, atol=0.1)


def test_a_speck_of_its_own_is_erased_as_a_whole():
    beside = seen(CAPSULE).outline.points.max(axis=0) + np.array([16.0, -40.0])
    picture = Picture.from_array(dirty(CAPSULE, beside, radius=6.0))
    background = Picture.from_array(CAPSULE.background)
    assert not detect(picture, background=background).status.ok
    found = detect(picture, background=background, by_hand=ByHand(erase=(*(beside - 9.0), 18.0, 18.0)))
    assert found.status is Status.DONE


def test_nothing_is_measured_where_most_of_the_outline_or_an_end_is_erased():
    points = seen(CAPSULE).outline.points
    right, middle = points[:, 0].max(), points.mean(axis=0)
    for box in ((right - 30.0, 5.0, 60.0, 190.0), (*(middle - 90.0), 180.0, 180.0)):
        assert not seen(CAPSULE, erase=box).status.ok


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        ("1, 2, 3", "erase: expected left column, upper row, width and height of each box"),
        ("1, 2, 3, 0", "width and height of each box in px"),
        ("", "width and height of each box in px"),
        ("1 2 3 4; 5 6 seven 8", "width and height of each box in px"),
        ("500, 0, 20, 20", "erase: expected a box within the picture of"),
    ],
)
def test_boxes_to_erase_that_cannot_be_are_refused(stated, expected):
    with pytest.raises(InputError, match=expected):
        seen(CAPSULE, erase=stated)


def test_a_film_has_nothing_to_erase(tmp_path):
    path = written(tmp_path / "film", film([60.0, 80.0, 100.0]))
    with pytest.raises(InputError, match="erase: expected nothing for a film"):
        measure_film(path, EXPERIMENT, frame_rate="1000 Hz", by_hand=ByHand(erase=(0, 0, 9, 9)))


@pytest.mark.parametrize(("walls", "crop"), [((150.0, 190.0), (0, 0, 200, 100)), ((10.0, 50.0), (0, 100, 200, 100))])
@pytest.mark.parametrize("contrast", ["dark", None])
def test_a_part_that_does_not_show_the_channel_shows_no_capsule(walls, crop, contrast):
    made = drawn(0.1, 0.9)
    by_hand = ByHand(walls=walls, crop=crop, contrast=contrast)
    seen = detect(Picture.from_array(made.picture), background=Picture.from_array(made.background), by_hand=by_hand)
    assert seen.status is Status.NO_CAPSULE
