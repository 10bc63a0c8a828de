"""Faults of a picture or its background: measured right, or refused by their own name."""

import cv2
import numpy as np
import pytest
from drawn import drawn
from scipy.ndimage import shift

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.image.by_hand import ByHand
from capsbayes.image.files import Picture
from capsbayes.image.film import measure_film
from capsbayes.image.measure import detect, measure
from capsbayes.image.synthetic import Optics
from capsbayes.quantity import Quantity
from capsbayes.status import Status

EXPERIMENT = Experiment(cross_section="square", half_width=25e-6, viscosity=0.85)
VELOCITY = Quantity(6e-3, 6e-5, "m/s")
MADE = drawn(0.03, 0.8, seed=4, shape=(160, 260), optics=Optics(electrons=8000))
SEEN, EMPTY = MADE.picture.astype(float), MADE.background.astype(float)
ROWS, COLUMNS = SEEN.shape
Y, X = np.mgrid[:ROWS, :COLUMNS].astype(float)
AROUND = ((X - 129.5) / 130.0) ** 2 + ((Y - 79.5) / 80.0) ** 2


def counts(grey):
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def turned(grey, degrees):
    turn = cv2.getRotationMatrix2D((129.5, 79.5), degrees, 1.0)
    return cv2.warpAffine(grey, turn, (COLUMNS, ROWS), borderMode=cv2.BORDER_REPLICATE)


def measured(picture, background=None, **how):
    return measure(picture, EXPERIMENT, capsule_velocity=VELOCITY, background=background, **how)


def check(picture, background=None):
    """The lengths over l hold the truth within three standard errors."""
    found = measured(picture, background)
    assert found.status is Status.DONE
    assert abs(found.axial_extent - MADE.axial_extent / MADE.half_width) < 3.0 * found.axial_extent_error


@pytest.mark.parametrize(
    ("picture", "background", "message"),
    [
        (SEEN, counts(0.7 * EMPTY), r"darker: its median is 0\.7 of the picture's; take both with the same exposure"),
        (0.5 * SEEN, EMPTY, "brighter: its median is 2 of the picture's"),
        (np.rint(16 * SEEN).astype(np.uint16), MADE.background, r"darker: .* \(8 bits, and the picture 12\)"),
        (MADE.picture, np.rint(16 * EMPTY).astype(np.uint16), r"brighter: .* \(12 bits, and the picture 8\)"),
        (SEEN, shift(EMPTY, (3, 0), order=1, mode="nearest"), r"lies 3\.0 px lower than it"),
        (SEEN, shift(EMPTY, (-5, 0), order=1, mode="nearest"), r"lies 5\.0 px higher than it"),
        (SEEN, turned(EMPTY, 1.0), r"is turned by 1\.0 degrees"),
        (SEEN, np.roll(SEEN, 20, axis=1), "the empty channel, got one with something dark at column 1"),
        (SEEN, SEEN, "the empty channel, got one with something dark at column 12"),
    ],
)
def test_a_background_that_does_not_fit_is_named(picture, background, message):
    with pytest.raises(InputError, match=f"background: expected .*{message}.*, or leave the background out"):
        measured(picture, background)


@pytest.mark.parametrize(
    "background",
    [0.85 * EMPTY, 1.15 * EMPTY, shift(EMPTY, (1, 0), order=1, mode="nearest"), EMPTY[:, ::-1], EMPTY[::-1]],
)
def test_a_background_that_is_hardly_off_does_no_harm(background):
    check(MADE.picture, counts(background))


def test_levels_below_zero_are_named_and_black_is_not_called_bright():
    with pytest.raises(InputError, match=r"got \d+% of them below zero, as after a subtraction; give the"):
        measured((SEEN - 150.0).astype(np.int16))
    check((SEEN - 30.0).astype(np.int16))
    assert measured(counts(SEEN - 130.0), by_hand=ByHand(walls=(19.5, 139.5), contrast="dark")).status is Status.BLACK


def test_what_is_no_picture_of_grey_levels_is_named():
    for mask in (SEEN > 120.0, 255 * (SEEN > 120.0).astype(np.uint8), 64 * (MADE.picture // 64)):
        with pytest.raises(
            InputError, match=r"expected grey levels of a camera, got (two|4) levels, as behind a thresh"
        ):
            measured(mask)
    for kind in (complex, str, object):
        with pytest.raises(InputError, match="expected real numbers as grey levels, got values of another kind"):
            measured(SEEN.astype(kind))


@pytest.mark.parametrize("loss", [0.3, 0.5, 0.6])
@pytest.mark.parametrize("with_background", [False, True])
def test_vignetting_is_measured_right(loss, with_background):
    light = 1.0 - 0.5 * loss * AROUND
    check(counts(SEEN * light), counts(EMPTY * light) if with_background else None)
    check(counts(SEEN * (1.0 - loss * X / COLUMNS)))


@pytest.mark.parametrize("deep", [0.3, 0.5])
@pytest.mark.parametrize("wide", [4, 8, 15])
def test_a_shadow_on_a_wall_is_measured_right_or_named(deep, wide):
    inwards = Y - (79.5 - MADE.half_width)
    shade = 1.0 - deep * np.exp(-np.maximum(0.0, inwards - wide) / 2.0) * (inwards > 0.0)
    check(counts(SEEN * shade))
    half = np.where(X < COLUMNS / 2, 1.0, shade)
    assert measured(counts(SEEN * half), MADE.background).status is Status.SHADED


@pytest.mark.parametrize("level", [0, 40, 255])
@pytest.mark.parametrize("with_background", [False, True])
def test_a_dead_row_or_column_is_filled_or_named(level, with_background):
    for place in (np.s_[5], np.s_[27], np.s_[79], np.s_[:, 8], np.s_[:, 129]):
        picture, background = MADE.picture.copy(), MADE.background.copy()
        picture[place] = background[place] = level
        check(picture, background if with_background else None)
    picture[:, round(MADE.outline[:, 0].max())] = level
    assert measured(picture, MADE.background if with_background else None).status is Status.DEAD_COLUMN


@pytest.mark.parametrize("place", [np.s_[50, :130], np.s_[79:81, 130:], np.s_[60, 100:]])
def test_half_a_dead_row_is_named(place):
    """It joins the capsule to the border."""
    picture = MADE.picture.copy()
    picture[place] = 0
    assert measured(picture).status is measured(picture, MADE.background).status is Status.SHADED
    assert measured(MADE.picture[:, 100:]).status is Status.TOUCHES_BORDER


def test_the_walls_of_two_channels_are_no_channel():
    stacked = np.vstack([MADE.picture, MADE.picture])
    assert measured(stacked).status is Status.NO_WALLS
    assert "or several channels; cut it around one" in str(Status.NO_WALLS)
    cut = measured(stacked, by_hand=ByHand(crop=(0, 0, COLUMNS, ROWS)))
    np.testing.assert_allclose(cut.lengths, measured(MADE.picture).lengths)


def test_hot_pixels_do_no_harm():
    picture = MADE.picture.copy()
    random = np.random.default_rng(1)
    picture[random.integers(0, ROWS, 40), random.integers(0, COLUMNS, 40)] = 255
    check(picture, MADE.background)


def test_a_channel_that_runs_up_and_down_is_named_and_turned_when_asked(tmp_path):
    upright, empty = np.rot90(MADE.picture), np.rot90(MADE.background)  # by a quarter counterclockwise
    for background in (None, empty):
        assert measured(upright, background).status is Status.UPRIGHT
        found = measured(upright, background, by_hand=ByHand(rotate="90"))
        np.testing.assert_allclose(
            found.lengths, measured(MADE.picture, None if background is None else MADE.background).lengths
        )
    placed = ByHand(rotate=90, pixel_size="0.4167 +/- 0.004 um", axis=79.5)
    seen = detect(Picture.from_array(upright), by_hand=placed, half_width="25 +/- 0.2 um")
    assert seen.lengths[0] == pytest.approx(MADE.axial_extent, abs=0.4)
    unturned = ByHand(pixel_size="0.4167 +/- 0.004 um")
    assert detect(Picture.from_array(upright), by_hand=unturned, half_width="25 um").status is Status.UPRIGHT
    with pytest.raises(InputError, match="rotate: expected 90, 180, 270 degrees clockwise, got '45'"):
        ByHand(rotate="45")
    folder = tmp_path / "film"
    folder.mkdir()
    for number in range(12):
        at = (60.0 + 10.0 * number, 44.5)
        frame = drawn(0.03, 0.8, half_width=30.0, seed=number, shape=(90, 240), centre=at).picture
        cv2.imwrite(str(folder / f"{number}.png"), np.rot90(frame))
    assert measure_film(folder, EXPERIMENT, frame_rate="400 Hz").status is Status.UPRIGHT
    film = measure_film(folder, EXPERIMENT, frame_rate="400 Hz", by_hand=ByHand(rotate=90))
    assert film.capsules[0].status is Status.DONE
