"""Films that show the empty channel badly, or were taken under a lamp that flickers, in turns or in two fields."""

import functools
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from drawn_film import HALF_WIDTH, SHAPE, bright, film

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.image import Picture, detect
from capsbayes.image.film import measure_film
from capsbayes.image.motion import Drift
from capsbayes.status import Status

EXAMPLE = Path(__file__).parents[2] / "examples/pictures"
EXPERIMENT = Experiment.read(EXAMPLE / "experiment.toml")
TRUTH = tomllib.loads((EXAMPLE / "truth.toml").read_text())
LENGTHS = np.array([TRUTH["axial_extent_over_l"], TRUTH["axial_length_over_l"]])
DRAWN = np.array([bright(x=65.0).axial_extent, bright(x=65.0).axial_length]) / HALF_WIDTH


@functools.cache
def example():
    video = cv2.VideoCapture(str(EXAMPLE / "film.avi"))
    return [cv2.cvtColor(video.read()[1], cv2.COLOR_BGR2GRAY) for _ in range(13)]


def measured(path, frames, **options):
    """Measure a film of some frames, as one TIFF file."""
    cv2.imwritemulti(str(path / "film.tif"), list(frames))
    return measure_film(path / "film.tif", EXPERIMENT, **options)


def in_light(frame, factor):
    return np.clip(np.rint(frame * factor), 0, 255).astype(np.uint8)


def off(capsule, lengths=LENGTHS):
    """Errors of the lengths over those that are stated."""
    return (capsule.measurement.lengths - lengths) / np.sqrt(np.diag(capsule.measurement.covariance))


@pytest.mark.parametrize("count", range(5, 14))
def test_the_first_and_the_last_frames_of_a_film_are_right_or_refused(tmp_path, count):
    """In few frames the median still shows the capsule, where it covers a place in almost half of them."""
    for first in {0, 13 - count}:
        made = measured(tmp_path, example()[first : first + count])
        if count < 9:
            assert made.status is Status.COVERED
            continue
        (capsule,) = made.capsules
        assert capsule.status is Status.DONE
        assert np.max(np.abs(off(capsule))) < 2.0
        assert not any(capsule.drifts[name].significant for name in ("L_z", "L_a"))
        assert capsule.table()["alike"].sum() == count


@pytest.mark.parametrize("share", [0.5, 0.7])
def test_a_video_that_breaks_off_is_refused(tmp_path, share):
    whole = (EXAMPLE / "film.avi").read_bytes()
    (tmp_path / "film.avi").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InputError, match=rf"a whole AVI file, got {int(share * len(whole))} of its {len(whole)} bytes"):
        measure_film(tmp_path / "film.avi", EXPERIMENT)


def test_parts_of_a_film_of_two_capsules_are_right_or_refused(tmp_path):
    """The second capsule is seven steps behind the first."""
    both = film(24.0 * np.arange(-1, 20)[:, None] - [0.0, 168.0], 3)
    done = []
    for first, count in ((1, 9), (2, 12), (4, 12), (0, 15), (1, 19)):
        for capsule in measured(tmp_path, both[first : first + count]).capsules:
            if capsule.status.ok:
                assert np.max(np.abs(off(capsule, DRAWN))) < 2.5
                done.append(count)
    assert done.count(19) == 2


@pytest.mark.parametrize("lamp", ["random", "by turns", "fading"])
def test_the_light_of_the_lamp_does_not_matter(tmp_path, lamp):
    number = np.arange(13)
    factors = {
        "random": 0.85 * (1.0 + 0.2 * np.random.default_rng(1).uniform(-1.0, 1.0, 13)),
        "by turns": np.where(number % 2, 0.9, 0.75),
        "fading": 1.0 - 0.03 * number,
    }[lamp]
    frames = [in_light(frame, factor) for frame, factor in zip(example(), factors, strict=True)]
    (capsule,) = measured(tmp_path, frames).capsules
    (steady,) = measured(tmp_path, example()).capsules
    assert capsule.status is Status.DONE
    np.testing.assert_allclose(capsule.measurement.lengths, steady.measurement.lengths, atol=0.001)
    assert capsule.alike.all()


def test_a_background_of_another_brightness_does_not_matter(tmp_path):
    empty = np.median(example(), axis=0)
    for factor in (0.5, 0.8, 1.1):
        (capsule,) = measured(tmp_path, example(), background=in_light(empty, factor)).capsules
        assert capsule.status is Status.DONE
        assert np.max(np.abs(off(capsule))) < 2.0


def test_capsules_may_cover_most_of_a_narrow_picture(tmp_path):
    """The light of a frame is not that of the capsules in it."""
    part = slice(8, 110), slice(100, 250)
    frames = [frame[part] for frame in film(np.arange(155.0, 196.0, 8.0), 2)]
    empty = bright(x=65.0).background[part]
    (capsule,) = measured(tmp_path, frames, background=empty).capsules
    assert np.max(np.abs(off(capsule, DRAWN))) < 2.5


@pytest.mark.parametrize("other", ["exposure", "fluorescence", "dark field", "a frame dropped"])
def test_two_channels_that_take_turns_are_named(tmp_path, other):
    empty = np.median(example(), axis=0)
    glow = 10.0 + np.clip(empty - np.array(example()), 0.0, None)
    frames = {
        "exposure": [in_light(frame, 0.5) for frame in example()],
        "fluorescence": [in_light(frame, 1.0) for frame in glow],
        "dark field": [255 - frame for frame in example()],
    }.get(other, [in_light(frame, 0.5) for frame in example()])
    mixed = [one if number % 2 else two for number, (one, two) in enumerate(zip(frames, example(), strict=True))]
    if other == "a frame dropped":
        del mixed[5]
    assert measured(tmp_path, mixed).status is Status.TAKE_TURNS
    assert "split the film" in str(Status.TAKE_TURNS)
    (capsule,) = measured(tmp_path, example()[::2] + example()[1::2][:2], flow="right").capsules[:1]
    assert capsule.status is not Status.TAKE_TURNS


@pytest.mark.parametrize("step", [1.5, 6.0, 23.37])
def test_interlaced_frames_are_named(tmp_path, step):
    """The even rows of a frame show the capsule half a step further downstream than the odd ones."""
    places = 90.0 + step * np.arange(6)
    odd, even = film(places, 1), film(places + 0.5 * step, 2)
    rows = np.arange(SHAPE[0])[:, None] % 2 == 0
    frames = [np.where(rows, late, early) for early, late in zip(odd, even, strict=True)]
    empty = bright(x=65.0).background
    (capsule,) = measured(tmp_path, frames, background=empty).capsules
    assert capsule.status is Status.INTERLACED
    assert detect(Picture.from_array(frames[2])).status is Status.INTERLACED
    assert detect(Picture.from_array(odd[2])).status is Status.DONE


def test_a_significant_change_of_one_length_is_in_the_errors_of_both(tmp_path, monkeypatch):
    (plain,) = measured(tmp_path, example()).capsules
    changes = iter([0.003, 0.008])
    monkeypatch.setattr(
        "capsbayes.image.film_capsule.drift",
        lambda *_: Drift(change := next(changes), 0.002 if change > 0.005 else 0.0015),
    )
    (changing,) = measured(tmp_path, example()).capsules
    assert changing.status is Status.DONE
    widened = np.sqrt(np.diag(changing.measurement.covariance) - np.diag(plain.measurement.covariance))
    np.testing.assert_allclose(widened / plain.measurement.lengths, [0.003, 0.008], rtol=0.02)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (lambda empty: np.roll(empty, 3, axis=0), r"lies 3\.0 px lower than it"),
        (lambda empty: np.roll(empty, -2, axis=0), r"lies 2\.0 px higher than it"),
        (lambda empty: scaled(empty, 1.0, -0.7), r"is turned by 0\.7 degrees"),
        (lambda empty: scaled(empty, 0.8), r"shows a channel 20\.\d% narrower"),
        (lambda empty: scaled(empty, 1.02), r"shows a channel 1\.9% wider"),
        (lambda _: example()[4], "the empty channel, got one with something dark at column 128"),
        (lambda empty: np.full_like(empty, 180), "a background of the same channel, got one without its walls"),
        (lambda empty: empty.astype(np.uint16) * 16, r"brighter: .* \(12 bits, and the picture 8\)"),
        (lambda empty: in_light(empty, 0.1), "darker"),
    ],
)
@pytest.mark.parametrize("contrast", ["dark", "bright"])
def test_a_background_that_does_not_fit_the_film_is_named(tmp_path, changed, message, contrast):
    frames = example() if contrast == "dark" else [255 - frame for frame in example()]
    empty = changed(np.median(frames, axis=0).astype(np.uint8))
    empty = 255 - empty if contrast == "bright" and empty is example()[4] else empty
    with pytest.raises(InputError, match=f"background: expected .*{message}.*, or leave the background out"):
        measured(tmp_path, frames, background=empty)


def scaled(grey, factor, degrees=0.0):
    rows, columns = grey.shape
    move = cv2.getRotationMatrix2D((0.5 * (columns - 1), 0.5 * (rows - 1)), degrees, factor)
    return cv2.warpAffine(grey, move, (columns, rows), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
