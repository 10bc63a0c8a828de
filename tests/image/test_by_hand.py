"""Walls, scale, part and faults of a picture as a person states them."""

import numpy as np
import pytest
from drawn import dirty, drawn
from drawn_film import bright, film, written

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.image import ByHand, Picture, detect, measure
from capsbayes.image.film import measure_film
from capsbayes.image.measure import silhouette_of
from capsbayes.image.overlay import DOUBT, overlay
from capsbayes.measurement import Measurement
from capsbayes.quantity import Quantity
from capsbayes.status import Status
from evidence.synthetic import Optics

EXPERIMENT = Experiment(cross_section="square", half_width="25.0 +/- 0.1 um", viscosity=0.85)
VELOCITY = Quantity(6e-3, 6e-5, "m/s")
CAPSULE = drawn(0.08, 1.05, half_width=55.0)
BLANK = Picture.from_array(np.full((200, 200), 100, dtype=np.uint8))


def rows_of_walls(scene, upper=0.0, lower=0.0):
    """Rows of either wall at the left and the right border, moved by so much."""
    x, y = scene.middle
    apart = scene.half_width / np.cos(scene.tilt)
    axis = y + np.tan(scene.tilt) * (np.array([0.0, scene.shape[1] - 1.0]) - x)
    return [*(axis - apart + upper), *(axis + apart + lower)]


def seen(made, picture=None, *, background=True, **stated):
    picture = Picture.from_array(made.picture if picture is None else picture)
    empty = Picture.from_array(made.background) if background else None
    return detect(picture, background=empty, by_hand=ByHand(**stated), half_width=EXPERIMENT.half_width)


@pytest.fixture(scope="module")
def clean():
    """The capsule as it is found, with nothing stated."""
    return seen(CAPSULE)


@pytest.mark.parametrize("tilt", [0.0, 0.03, 0.25])
def test_stated_walls_give_the_lengths_of_those_that_are_found(tilt):
    made = drawn(0.08, 1.05, half_width=55.0, shape=(260, 260), tilt=tilt, centre=(126.0, 131.0))
    stated = seen(made, walls=rows_of_walls(made.scene), wall_error=0.5)
    assert stated.status is Status.DONE
    truth = [made.axial_extent, made.axial_length, made.axial_extent - made.axial_length, made.half_width]
    np.testing.assert_allclose(stated.lengths, truth, atol=0.3)
    assert stated.walls.tilt == pytest.approx(tilt, abs=1e-6)
    assert stated.walls.half_width_error == pytest.approx(0.5 / np.sqrt(2.0), rel=0.05)
    if tilt < 0.1:
        np.testing.assert_allclose(stated.lengths, seen(made).lengths, atol=0.05)


def test_a_part_of_the_picture_is_measured_where_it_lies():
    """One of two capsules: its outline is in the pixels of the whole picture."""
    made, second = (drawn(0.1, 0.9, half_width=50.0, shape=(200, 300), centre=(x, 99.5)) for x in (90.0, 220.0))
    both = np.hstack([made.picture[:, :155], second.picture[:, 155:]])
    assert seen(made, both).status is Status.SEVERAL_CAPSULES
    alone = seen(made)
    for stated in ({}, {"walls": rows_of_walls(made.scene)}):
        part = seen(made, both, crop="8, 10, 150, 180 px", **stated)
        assert part.status is Status.DONE
        np.testing.assert_allclose(part.lengths, alone.lengths, atol=0.1)
        np.testing.assert_allclose(part.outline.points.mean(axis=0), alone.outline.points.mean(axis=0), atol=0.1)
        np.testing.assert_allclose(part.axis, alone.axis, atol=0.1)
        assert part.nose.distance == pytest.approx(alone.nose.distance, abs=0.1)
        assert part.walls.centre_row == pytest.approx(alone.walls.centre_row, abs=0.2)


@pytest.mark.parametrize("background", [True, False])
def test_a_pixel_size_needs_no_walls(background):
    """The picture shows none: the channel is wider than it."""
    picture, empty = CAPSULE.picture[50:150], CAPSULE.background[50:150] if background else None
    how = {"capsule_velocity": VELOCITY, "background": empty}
    refused = measure(picture, EXPERIMENT, **how)
    assert refused.status is Status.NO_WALLS
    assert all(option in str(refused.status) for option in ("--walls", "--pixel-size", "--axis"))
    size = Quantity(25e-6 / 55.0, 0.01 * 25e-6 / 55.0, "m")
    measured = measure(picture, EXPERIMENT, **how, by_hand=ByHand(pixel_size=size, axis="49.5 px"))
    np.testing.assert_allclose(
        measured.lengths, np.array([CAPSULE.axial_extent, CAPSULE.axial_length]) / 55, atol=0.015
    )
    scale = np.hypot(0.01, 0.1 / 25.0)
    assert measured.axial_extent_error / measured.axial_extent == pytest.approx(scale, rel=0.1)
    assert measured.outline.pose.offset > 0.5 * scale
    with pytest.raises(InputError, match="half width: expected that of the channel"):
        detect(BLANK, by_hand=ByHand(pixel_size="0.3 +/- 0.01 um"))


def test_a_measurement_says_that_its_walls_were_stated_and_that_they_are_off(tmp_path):
    picture = CAPSULE.picture
    for walls, off in (("44.5, 154.5", False), ("42.5, 154.5", True)):
        by_hand = ByHand(walls=walls, wall_error="0.5 px")
        measured = measure(picture, EXPERIMENT, capsule_velocity=VELOCITY, by_hand=by_hand)
        assert measured.walls == f"walls by hand at rows {walls} px, each +/- 0.5 px"
        measured.write(tmp_path / "m.toml")
        again = Measurement.read(tmp_path / "m.toml")
        assert (again.walls, again.doubt) == (measured.walls, measured.doubt)
        assert (measured.doubt != "") == off
        assert measured.walls in repr(again)
        assert measured.doubt in repr(again)
    found = measure(picture, EXPERIMENT, capsule_velocity=VELOCITY)
    assert found.walls == ""
    assert "walls" not in found.described()


def test_stated_walls_are_dashed_in_the_overlay_and_lines_that_they_are_off_yellow():
    picture = Picture.from_array(CAPSULE.picture)

    def drawn_over(first, last, **stated):
        canvas = overlay(picture, detect(picture, by_hand=ByHand(**stated))).astype(int)[4 * first : 4 * last]
        return canvas[..., 0] - canvas[..., 2]  # blue less red

    def blue(**stated):
        return np.mean(np.any(drawn_over(44, 46, **stated) > 100, axis=0))

    assert blue() > 0.95
    assert 0.4 < blue(walls="44.5, 154.5") < 0.8
    yellow = 0.3 * (DOUBT[2] - DOUBT[0])
    assert np.count_nonzero(-drawn_over(43, 46, walls="38.5, 154.5") > yellow) > 100
    assert np.count_nonzero(-drawn_over(43, 46, walls="44.5, 154.5") > yellow) == 0


TILTED = drawn(0.08, 1.05, half_width=55.0, tilt=0.02)


def off_band(upper, lower, made=TILTED, **stated):
    """Walls that are stated so far from where they are."""
    return seen(made, walls=rows_of_walls(made.scene, upper, lower), **stated).walls


@pytest.mark.parametrize("background", [True, False])
def test_a_wall_six_pixels_outside_its_band_is_warned_of(background):
    walls = off_band(-6.0, 0.0, background=background)
    assert walls.off_band == (pytest.approx(6.0, abs=0.7), 0.0)
    assert walls.doubt.startswith("The upper wall lies")
    assert "px outside the nearest dark line of the picture; if that is the wall, l is" in walls.doubt
    assert float(walls.doubt.split("l is ")[1].split("%")[0]) == pytest.approx(100.0 * 3.0 / 58.0, abs=0.7)
    assert walls.doubt.endswith("smaller.")
    walls = off_band(6.0, 6.0, background=background)
    assert walls.off_band == (pytest.approx(-6.0, abs=0.7), pytest.approx(6.0, abs=0.7))
    assert walls.doubt.startswith("The walls lie 6.")
    assert "inside and" in walls.doubt


@pytest.mark.parametrize("background", [True, False])
def test_walls_off_their_bands_are_doubted_or_refused(background):
    """One 3 px off is doubted; both 6 px off would make every length wrong by a tenth of l."""
    doubted = off_band(0.0, 3.0, background=background)
    assert doubted.off_band == (0.0, pytest.approx(3.0, abs=0.2))
    assert doubted.doubt.startswith("The lower wall lies")
    for away in (6.0, -6.0):
        moved = rows_of_walls(TILTED.scene, -away, away)
        refused = seen(TILTED, walls=moved, background=background)
        assert refused.status is Status.WALLS_OFF
        assert refused.outline is None
        assert refused.walls.change == pytest.approx(-away, abs=0.7)
        assert seen(TILTED, walls=moved, wall_error=4.0, background=background).status is Status.DONE


def test_walls_on_their_bands_are_not():
    """Nor walls off by less than their stated error allows, nor in a picture that shows no dark line there."""
    assert off_band(0.0, 0.0).doubt == ""
    assert off_band(1.0, -1.0).doubt == ""
    assert off_band(-6.0, 0.0, wall_error=4.0).doubt == ""
    bare = drawn(0.08, 1.05, half_width=55.0, optics=Optics(wall_depth=0.0, outside=1.0))
    assert off_band(-6.0, 0.0, bare).doubt == ""
    assert detect(Picture.from_array(TILTED.picture)).walls.doubt == ""


def test_a_film_with_stated_walls_or_pixel_size(tmp_path):
    places, row = 65.0 + 23.37 * np.arange(5), 0.5 * (118 - 1)
    folder, empty = written(tmp_path / "film", film(places)), bright(x=places[0]).background

    def measured(**stated):
        made = measure_film(folder, EXPERIMENT, frame_rate=2000.0, background=empty, by_hand=ByHand(**stated))
        return made.capsules[0].measurement

    known = measured()
    size = Quantity(25e-6 / 45.0, 0.002 * 25e-6 / 45.0, "m")
    for stated in ({"walls": (row - 45.0, row + 45.0)}, {"pixel_size": size, "crop": "5, 4, 320, 110"}):
        capsule = measured(**stated)
        assert capsule.status is Status.DONE
        assert capsule.walls
        assert capsule.axial_extent == pytest.approx(known.axial_extent, rel=5e-3)
        assert capsule.capsule_velocity == pytest.approx(23.37 * size.value * 2000.0, rel=5e-3)
    # the velocity needs the size of a pixel alone, whose error is smaller than that of the half width
    assert capsule.capsule_velocity_error < 0.003 * capsule.capsule_velocity
    assert measured(walls=(row - 51.0, row + 45.0)).doubt.startswith("The upper wall lies")
    off = ByHand(walls=(row - 51.0, row + 51.0))
    wider = measured(edge_offset="0.4 +/- 0.02 px")
    assert 45.0 * (wider.axial_extent - known.axial_extent) == pytest.approx(0.8, abs=0.02)
    assert wider.axial_extent_error < known.axial_extent_error
    refused = measure_film(folder, EXPERIMENT, frame_rate=2000.0, background=empty, by_hand=off)
    assert refused.status is Status.WALLS_OFF
    with pytest.raises(InputError, match="erase: expected nothing for a film"):
        measured(erase=(0, 0, 9, 9))


def with_gamma(grey, gamma):
    """The grey levels that a camera of this gamma keeps of those of a linear one."""
    return np.rint(255.0 * (grey / 255.0) ** (1.0 / gamma)).astype(np.uint8)


@pytest.mark.parametrize("background", [True, False])
@pytest.mark.parametrize("gamma", [2.2, 0.5])
def test_a_stated_gamma_gives_the_lengths_of_a_linear_camera(gamma, background):
    linear = seen(CAPSULE, background=background)
    shown = Picture.from_array(with_gamma(CAPSULE.picture, gamma))
    empty = Picture.from_array(with_gamma(CAPSULE.background, gamma)) if background else None
    assert abs(detect(shown, background=empty).lengths[0] - linear.lengths[0]) > 0.15
    stated = detect(shown, background=empty, by_hand=ByHand(gamma=f"{gamma}"))
    np.testing.assert_allclose(stated.lengths, linear.lengths, atol=0.05)
    np.testing.assert_allclose(stated.covariance, linear.covariance, rtol=0.2, atol=1e-3)


def test_a_measurement_says_which_gamma_was_stated(tmp_path):
    shown = with_gamma(CAPSULE.picture, 2.0)
    by_hand = ByHand(gamma=2, walls="42.5, 154.5", wall_error="0.5 px")
    measured = measure(shown, EXPERIMENT, capsule_velocity=VELOCITY, by_hand=by_hand)
    said = " The grey levels are taken to be the light to the power of 1/2, as stated (--gamma)."
    assert measured.doubt.startswith("The upper wall lies")
    assert measured.doubt.endswith(said)
    measured.write(tmp_path / "m.toml")
    assert Measurement.read(tmp_path / "m.toml").doubt == measured.doubt
    frames = [with_gamma(frame, 2.0) for frame in film(65.0 + 23.37 * np.arange(5))]
    folder, empty = written(tmp_path / "film", frames), with_gamma(bright(x=65.0).background, 2.0)
    how = {"frame_rate": 2000.0, "background": empty, "by_hand": ByHand(gamma=2.0)}
    capsule = measure_film(folder, EXPERIMENT, **how).capsules[0].measurement
    assert capsule.doubt == said.strip()
    linear = written(tmp_path / "linear", film(65.0 + 23.37 * np.arange(5)))
    plain = measure_film(linear, EXPERIMENT, frame_rate=2000.0, background=bright(x=65.0).background)
    assert capsule.axial_extent == pytest.approx(plain.capsules[0].measurement.axial_extent, abs=0.001)


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
        ({"edge_offset": "0.1"}, 'edge offset: expected a standard error, as in "0.12 +/- 0.05 px"'),
        ({"edge_offset": "0.1 +/- 0.05 um"}, "edge offset: expected"),
        ({"edge_offset": "9 +/- 1 px"}, "edge offset: expected less than 3 px, got 9"),
        ({"crop": "0, 0, 400, 100"}, "crop: expected a part of the picture of 200 x 200 px, got 0, 0, 400, 100"),
        ({"crop": "-1, 0, 100, 100"}, "a part of the picture"),
        ({"crop": "0, 0, 8, 100"}, "crop: expected at least 16 x 16 px, got 8 x 100 px"),
        ({"crop": "some"}, "crop: expected left column, upper row, width and height in px"),
        *(
            ({"gamma": g}, 'gamma: expected a number above 0, at most 4, as "2.2", got')
            for g in ("0", -1, 4.1, "x", "")
        ),
        ({"gamma": np.nan}, "gamma: expected a number above 0"),
        ({"contrast": "light"}, 'contrast: expected "dark" or "bright"'),
        ({"erase": "1, 2, 3"}, "erase: expected left column, upper row, width and height of each box"),
        ({"erase": "1, 2, 3, 0"}, "width and height of each box in px"),
        ({"erase": ""}, "width and height of each box in px"),
        ({"erase": 5}, "width and height of each box in px"),
        ({"erase": "1 2 3 4; 5 6 seven 8"}, "width and height of each box in px"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(stated, message):
    with pytest.raises(InputError) as caught:
        detect(BLANK, by_hand=ByHand(**stated), half_width="25 um")
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("place", [0.0, 0.25, 0.5, 0.8])
def test_dirt_on_the_outline_is_erased_and_the_lengths_are_those_without_it(clean, place):
    k = int(place * len(clean.outline.points))
    at = clean.outline.points[k] + 3.0 * clean.outline.normals[k]
    assert seen(CAPSULE, dirty(CAPSULE, at)).status is Status.DOUBLET
    left = seen(CAPSULE, dirty(CAPSULE, at), erase=(*(at - 13.0), 26.0, 26.0))
    assert left.status is Status.DONE
    off = (left.lengths - clean.lengths) / np.sqrt(np.diag(left.covariance))
    assert np.abs(off).max() < 1.0
    points, erased = left.outline.points, left.outline.erased
    assert 10 < erased.sum() < 40
    assert np.abs(points[erased] - at).max() < 20.0
    apart = np.hypot(*(points[:, None] - clean.outline.points).T).min(axis=0)
    assert apart[~erased].max() < 0.75  # of points 1.25 px apart
    assert np.all(apart[erased] < 0.75 + 2.0 * left.outline.point_error[erased])


def test_erased_stretches_are_no_part_of_the_silhouette_and_are_dotted_in_the_overlay(clean):
    at = clean.outline.points[len(clean.outline.points) // 4]
    left = seen(CAPSULE, erase=f"{at[0] - 10:.0f}, {at[1] - 10:.0f}, 20, 20 px")
    whole, rest = silhouette_of(clean), silhouette_of(left)
    assert len(whole.points) - 9 <= len(rest.points) <= len(whole.points) - 4
    assert rest.noise.scale == pytest.approx(whole.noise.scale, rel=0.2)
    drawings = [overlay(Picture.from_array(CAPSULE.picture), each).astype(int) for each in (clean, left)]
    (column, row), size = np.rint(4.0 * (at - 10.0)).astype(int), 80
    red = [drawing[:, :, 2] - drawing[:, :, 1] > 90 for drawing in drawings]
    whole, rest = (np.count_nonzero(each[row : row + size, column : column + size]) for each in red)
    assert 0.1 * whole < rest < 0.6 * whole
    assert np.count_nonzero(red[1]) > 0.8 * np.count_nonzero(red[0])
    part = seen(CAPSULE, erase=[(*(at - 10.0), 20.0, 20.0)], crop=(10, 8, 180, 180))  # in pixels of the whole picture
    assert left.outline.erased.sum() == pytest.approx(part.outline.erased.sum(), abs=2)
    np.testing.assert_allclose(part.lengths, left.lengths, atol=0.1)


def test_a_speck_of_its_own_is_erased_as_a_whole_and_little_that_is_left_is_not_measured(clean):
    points = clean.outline.points
    beside = points.max(axis=0) + np.array([16.0, -40.0])
    picture = dirty(CAPSULE, beside, radius=6.0)
    assert not seen(CAPSULE, picture).status.ok
    assert seen(CAPSULE, picture, erase=(*(beside - 9.0), 18.0, 18.0)).status is Status.DONE
    right, middle = points[:, 0].max(), points.mean(axis=0)
    for box in ((right - 30.0, 5.0, 60.0, 190.0), (*(middle - 90.0), 180.0, 180.0)):
        assert not seen(CAPSULE, erase=box).status.ok
    with pytest.raises(InputError, match="erase: expected a box within the picture of"):
        seen(CAPSULE, erase="500, 0, 20, 20")


@pytest.mark.parametrize(("walls", "crop"), [((150.0, 190.0), (0, 0, 200, 100)), ((10.0, 50.0), (0, 100, 200, 100))])
@pytest.mark.parametrize("contrast", ["dark", None])
def test_a_part_that_does_not_show_the_channel_shows_no_capsule(walls, crop, contrast):
    assert seen(drawn(0.1, 0.9), walls=walls, crop=crop, contrast=contrast).status is Status.NO_CAPSULE
