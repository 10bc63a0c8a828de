"""Capsules of drawn films: lengths, velocities, silhouettes, and films with faults."""

import functools
import tomllib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import scipy.linalg
from drawn_film import HALF_WIDTH, SHAPE, bright, exposed, film, written

from capsbayes.errors import InputError
from capsbayes.experiment import Camera, Experiment
from capsbayes.image.by_hand import ByHand
from capsbayes.image.files import Film, Picture
from capsbayes.image.film import FilmMeasurement, measure_film
from capsbayes.image.film_capsule import AlignedOutlines, FrameMeasurement
from capsbayes.image.measure import detect, silhouette_of
from capsbayes.image.motion import Drift, drift, times_of, velocity
from capsbayes.infer.outline import aligned_with
from capsbayes.measurement import Measurement, askew_size
from capsbayes.profile import signed_area
from capsbayes.quantity import Quantity
from capsbayes.status import Status

EXPERIMENT = Experiment(cross_section="square", half_width=25e-6, viscosity=0.85)
RATE = Quantity(2000.0, 0.0, "1/s")
STEP = 23.37  # px per frame
PLACES = 65.0 + STEP * np.arange(9)
NOSE = 0.5 * bright(x=PLACES[0]).axial_extent
EMPTY = bright(x=PLACES[0]).background
DRAWN = np.array([bright(x=PLACES[0]).axial_extent, bright(x=PLACES[0]).axial_length]) / HALF_WIDTH
TRUTH = bright(x=PLACES[0]).scene.silhouette


def measured(folder, frames, *, experiment=EXPERIMENT, rate=RATE, background=EMPTY, **options):
    return measure_film(written(folder, frames), experiment, frame_rate=rate, background=background, **options)


def capsule_in(folder, frames, **options):
    (capsule,) = measured(folder, frames, **options).capsules
    return capsule


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """The film of one capsule in nine frames, measured."""
    return measured(tmp_path_factory.mktemp("plain") / "film", film(PLACES))


def counts(grey):
    return np.clip(np.rint(grey), 0, 255).astype(np.uint8)


def dimmed(grey, x, y, radius=6.0, *, dark=0.5, soft=0.02):
    """Grey levels with a dark disc in them."""
    yy, xx = np.mgrid[: SHAPE[0], : SHAPE[1]]
    away = (np.hypot(xx - x, yy - y) - radius) / soft
    return grey * (1.0 - dark / (1.0 + np.exp(np.clip(away, -50.0, 50.0))))


def test_velocity_and_lengths_lie_within_their_errors(tmp_path):
    """In pixels the velocity's error is that of the centroid's place; in metres that of the half width leads."""
    z, of_lengths, in_si = [], [], []
    for seed in range(5):
        capsule = capsule_in(tmp_path / str(seed), film(PLACES, seed))
        assert capsule.status is Status.DONE
        assert len(capsule.record.measured) == len(PLACES)
        seen = capsule.measurement
        z.append((capsule.velocity.value - STEP) / capsule.velocity.error)
        of_lengths.append((seen.lengths - DRAWN) / np.sqrt(np.diag(seen.covariance)))
        assert seen.axial_length is not None
        in_si.append((seen.capsule_velocity - STEP / HALF_WIDTH * 25e-6 * 2000.0) / seen.capsule_velocity_error)
        assert capsule.velocity.error < 2e-4 * STEP
    assert 0.2 < np.sqrt(np.mean(np.square(z))) < 1.6
    assert np.max(np.abs(of_lengths)) < 2.5
    assert np.max(np.abs(in_si)) < 2.5


@pytest.mark.parametrize("kept", [[0, 1, 3, 4, 5, 8], [0, 1, 1, 2, 3, 4, 5]], ids=["dropped", "repeated"])
def test_frames_that_were_dropped_or_repeated_leave_the_velocity_right(tmp_path, kept):
    frames = film(PLACES, 1)
    capsule = capsule_in(tmp_path / "film", [frames[number] for number in kept])
    assert capsule.status is Status.DONE
    assert abs(capsule.velocity.value - STEP) < 4.0 * capsule.velocity.error
    assert capsule.velocity.error < 1e-3 * STEP


@pytest.mark.parametrize("count", [8, 9])
@pytest.mark.parametrize("noise", [0.0, 0.4])
def test_a_film_in_which_most_frames_are_copies_is_refused(tmp_path, count, noise):
    """Their errors would not be independent, and the step from frame to frame may be that of one frame or of two."""
    rng = np.random.default_rng(1)
    twice = [counts(frame + noise * rng.standard_normal(SHAPE)) for frame in film(PLACES, 1) for _ in range(2)]
    capsule = capsule_in(tmp_path / "film", twice[:count])
    assert capsule.status is capsule.measurement.status is Status.REPEATED


def test_a_capsule_whose_mean_outline_is_lopsided_is_refused_in_the_table_too(tmp_path):
    """As a shutter takes it that reads row after row, 5 px later at each l further down."""
    columns, late = np.arange(SHAPE[1]), 5.0 * (np.arange(SHAPE[0]) - 0.5 * (SHAPE[0] - 1)) / HALF_WIDTH
    sheared = [
        np.array([np.interp(columns - way, columns, row) for way, row in zip(late, frame, strict=True)]).astype(
            np.uint8
        )
        for frame in film(PLACES)
    ]
    made = measured(tmp_path / "film", sheared)
    assert len(made.capsules[0].record.measured) == len(PLACES)
    assert made.capsules[0].status is made.capsules[0].measurement.status is Status.LOPSIDED
    assert made.table()["status"].tolist() == ["LOPSIDED"]


def test_exposure_half_width_and_frame_rate_count(tmp_path):
    """The capsule moves by 0.93 px in 20 us at 2000 pictures in a second, by 7 px in 150 us."""
    for exposure, status in (("20 us", Status.DONE), ("150 us", Status.SMEARED)):
        capsule = capsule_in(tmp_path / exposure, film(PLACES), experiment=replace(EXPERIMENT, exposure=exposure))
        assert capsule.status is capsule.measurement.status is status
    known = replace(EXPERIMENT, half_width=Quantity(25e-6, 0.5e-6))
    seen = capsule_in(tmp_path / "errors", film(PLACES), experiment=known, rate="2000 +/- 20 Hz").measurement
    assert seen.capsule_velocity_error / seen.capsule_velocity == pytest.approx(np.hypot(0.02, 0.01), rel=0.02)


def test_the_mean_has_less_noise_than_one_frame_and_the_same_misfit(tmp_path):
    capsule = capsule_in(tmp_path / "film", film(PLACES, 3, electrons=1000.0))
    frames = capsule.record.measured
    alone = np.median([(frame.covariance - frame.systematic)[0, 0] for frame in frames])
    lasting = np.median([frame.systematic[0, 0] for frame in frames])
    of_walls = frames[0].covariance[3, 3] * capsule.measurement.axial_extent**2
    of_odd_part = (
        2.0 * HALF_WIDTH * askew_size(capsule.measurement.outline.points, capsule.measurement.outline.noise)
    ) ** 2
    mean = capsule.measurement.covariance[0, 0] * HALF_WIDTH**2 - of_walls - of_odd_part
    assert 0.9 * lasting < mean < lasting + 0.5 * alone
    scatter = np.std([frame.lengths[0] for frame in frames], ddof=1)
    assert 0.2 < scatter / np.sqrt(alone) < 1.5


def test_everything_in_a_film_is_a_capsule_or_has_a_reason(tmp_path):
    """A capsule, two that overlap and a speck behind it; each is cut by the border for a while."""
    frames = []
    for number, x in enumerate(np.arange(PLACES[0] - 4.0 * STEP, 700.0, STEP)):
        grey = bright(x=float(x)).picture if x < SHAPE[1] + 55.0 else EMPTY
        for behind, radius in ((110.0, 6.0), (190.0, 18.0), (217.0, 18.0)):
            grey = dimmed(grey, x - behind, 58.5, radius, dark=0.4, soft=1.0 / 1.5)
        frames.append(exposed(grey, number))
    made = measured(tmp_path / "film", frames, background=None)
    assert [capsule.status for capsule in made.capsules] == [Status.DONE, Status.DEBRIS, Status.DOUBLET]
    assert made.capsules[0].velocity.value == pytest.approx(STEP, abs=0.01)
    assert made.statuses[Status.TOUCHES_BORDER] >= 5
    assert np.isnan(made.capsules[2].measurement.axial_extent)
    assert all(capsule.record.picture is not None for capsule in made.capsules)


def test_a_bad_frame_stops_nothing(tmp_path):
    folder = written(tmp_path / "film", film(PLACES))
    (folder / "frame4.png").write_bytes(b"no picture")
    made = measure_film(folder, EXPERIMENT, frame_rate=RATE, background=EMPTY)
    assert (made.frames, made.unreadable) == (9, 1)
    assert made.capsules[0].velocity.value == pytest.approx(STEP, abs=0.01)
    assert len(made.capsules[0].record.measured) == 8


def test_what_a_film_cannot_tell_has_a_status(tmp_path):
    assert capsule_in(tmp_path / "few", film(PLACES[:2])).status is Status.FEW_FRAMES
    assert measured(tmp_path / "stuck", film(np.full(4, PLACES[3])), background=None).status is Status.COVERED
    left = measured(tmp_path / "left", film(PLACES), flow="left")
    assert {capsule.status for capsule in left.capsules} == {Status.WRONG_FLOW}
    with pytest.raises(InputError, match='expected "right" or "left"'):
        measured(tmp_path / "up", film(PLACES), flow="up")
    with pytest.raises(InputError, match="camera: expected none for a film"):
        measured(tmp_path / "camera", film(PLACES), experiment=replace(EXPERIMENT, camera=Camera(pixel_aspect=1.02)))


def test_light_that_fades_along_the_channel_covers_nothing(tmp_path):
    """Vignetting darkens the ends of the field by a fifth: the median is the empty channel all the same."""
    fade = 1.0 - 0.2 * np.linspace(-1.0, 1.0, SHAPE[1]) ** 2
    moving, stuck = np.arange(-60.0, SHAPE[1] + 60.0, STEP), np.full(4, PLACES[3])
    faded = [[(frame * fade).astype(np.uint8) for frame in film(places)] for places in (moving, stuck)]
    capsule = capsule_in(tmp_path / "film", faded[0], background=None)
    assert capsule.status is Status.DONE
    assert capsule.velocity.value == pytest.approx(STEP, abs=0.02)
    assert measured(tmp_path / "stuck", faded[1], background=None).status is Status.COVERED


def test_a_capsule_that_lengthens_or_differs_in_many_frames_is_unsteady(tmp_path):
    """The second half of the first film is of the same capsule at a higher capillary number."""
    capsule = capsule_in(
        tmp_path / "longer", [film([x], capillary_number=0.06 + 0.02 * (x > 150.0))[0] for x in PLACES]
    )
    assert capsule.status is Status.UNSTEADY
    assert capsule.drifts["L_z"].unsteady
    frames = film(PLACES, 2)
    for number in (1, 4, 6):
        frames[number] = exposed(dimmed(frames[number], PLACES[number] + NOSE, 58.5), 1)
    assert capsule_in(tmp_path / "film", frames).status in (Status.UNSTEADY, Status.FEW_FRAMES)


def test_tables_and_files_hold_the_capsules(plain, tmp_path):
    table, (capsule,) = plain.table(), plain.capsules
    assert table.loc[0, ["capsule", "status", "frames"]].tolist() == [1, "DONE", len(PLACES)]
    assert table.loc[0, "velocity_m_s"] == capsule.measurement.capsule_velocity
    assert table.loc[0, "L_z_change"] == capsule.drifts["L_z"].change
    assert capsule.table()["frame"].tolist() == list(range(len(PLACES)))
    assert list(FilmMeasurement(Status.NO_WALLS).table().columns) == list(table.columns)
    capsule.measurement.write(tmp_path / "measurement.toml")
    read = Measurement.read(tmp_path / "measurement.toml").outline
    assert read.view == "silhouette"
    assert np.allclose(read.points, capsule.measurement.outline.points, atol=1e-8)
    assert read.noise == capsule.measurement.outline.noise


def test_a_stated_contrast_gives_the_same_from_the_first_frames(plain, tmp_path, monkeypatch):
    asked, frames = [], Film.frames

    def recorded(film, *part, only=None):
        asked.append(only)
        return frames(film, *part, only=only)

    monkeypatch.setattr(Film, "frames", recorded)
    stated = capsule_in(tmp_path / "stated", film(PLACES), by_hand=ByHand(contrast="dark"))
    assert asked == [None, None]
    capsule_in(tmp_path / "found", film(PLACES))
    assert asked[2:] == [
        set(range(12)),
        None,
    ]  # the contrast is sought in the first frames and others, all over the film
    assert stated.status is Status.DONE
    np.testing.assert_allclose(stated.measurement.lengths, plain.capsules[0].measurement.lengths, rtol=1e-6)


def detections(frames):
    background = Picture.from_array(EMPTY)
    return [detect(Picture.from_array(frame), background=background) for frame in frames]


def residuals(outline, truth=TRUTH):
    points, feet = aligned_with(outline.points, truth if signed_area(truth) > 0.0 else truth[::-1])
    return points, feet.distance


def misfit(outline):
    points, distance = residuals(outline)
    covariance = outline.noise.covariance(points) + outline.pose.offset**2
    factor = scipy.linalg.cholesky(covariance, lower=True)
    return np.mean(scipy.linalg.solve_triangular(factor, distance, lower=True) ** 2)


def test_the_mean_of_the_frames_is_nearer_to_the_truth_than_any_frame_and_says_so(tmp_path):
    squares = []
    for seed in range(4):
        frames = film(PLACES, seed, electrons=1500.0)
        together = capsule_in(tmp_path / str(seed), frames).measurement.outline
        alone = [silhouette_of(detection) for detection in detections(frames)]
        assert np.std(residuals(together)[1]) < 0.7 * min(np.std(residuals(outline)[1]) for outline in alone)
        assert together.noise.scale < 0.85 * min(outline.noise.scale for outline in alone)
        assert together.pose.offset < 1.1 * min(outline.pose.offset for outline in alone)
        squares.append(misfit(together))
    assert 0.2 < np.mean(squares) < 1.5


def test_what_all_frames_share_is_not_averaged_away(tmp_path):
    """Without noise, more frames hardly tell more: the misfit of the edge's model stays."""
    films = {count: film(PLACES[:count], 1, electrons=1e7) for count in (4, 9)}
    few, many = (capsule_in(tmp_path / str(n), frames).measurement.outline for n, frames in films.items())
    assert many.noise.scale == pytest.approx(few.noise.scale, rel=0.3)
    assert many.noise.scale * HALF_WIDTH > 0.01
    assert many.pose.offset == pytest.approx(few.pose.offset, rel=0.05)


def test_frames_with_a_fault_are_left_out_of_outline_and_lengths(tmp_path):
    """A speck lies on the nose in one frame, and beside a flank in another."""
    frames = film(PLACES, 2)
    whole = capsule_in(tmp_path / "whole", frames)
    frames[3] = exposed(dimmed(frames[3], PLACES[3] + NOSE, 58.5), 1)
    frames[6] = exposed(dimmed(frames[6], PLACES[6], 58.5 - 0.8 * HALF_WIDTH), 1)
    spoilt = capsule_in(tmp_path / "spoilt", frames)
    assert spoilt.status is Status.DONE
    assert whole.alike.all()
    numbers = [frame.frame for frame, alike in zip(spoilt.record.measured, spoilt.alike, strict=True) if alike]
    assert numbers == [0, 1, 2, 4, 5, 7, 8]
    assert spoilt.measurement.axial_extent == pytest.approx(whole.measurement.axial_extent, abs=0.002)
    assert misfit(spoilt.measurement.outline) < 2.0
    assert spoilt.table()["alike"].sum() == 7
    counted = FilmMeasurement(Status.DONE, (spoilt,)).table().loc[0, ["frames", "alike"]].tolist()
    assert counted == [len(spoilt.record.measured), 7]


@pytest.fixture(scope="module")
def in_frames():
    """Walls, and what is measured in each frame of a film."""
    made = detections(film(PLACES, 4))
    return made[0].walls, [FrameMeasurement.of(number, detection) for number, detection in enumerate(made)]


def test_blurred_frames_do_not_widen_the_noise_and_a_change_along_the_channel_does(in_frames):
    walls, frames = in_frames
    dull = replace(frames[0].errors, misfit=0.3, offset=0.3)
    mixed = AlignedOutlines.of([*frames[:6], *(replace(frame, errors=dull) for frame in frames[6:])])
    assert len(mixed.sharpest()) <= 6
    sharp = AlignedOutlines.of(frames[:6])
    assert mixed.sharpest().silhouette(walls, 1).noise.scale < 1.2 * sharp.silhouette(walls, 1).noise.scale
    steady, changing = (sharp.silhouette(walls, 1, change).noise.scale * HALF_WIDTH for change in (0.0, 0.5))
    assert changing == pytest.approx(np.hypot(steady, 0.5), rel=0.01)


def test_shift_turn_and_direction_leave_the_silhouette_as_it_is(in_frames):
    walls, frames = in_frames
    turn = np.array([[np.cos(0.02), np.sin(0.02)], [-np.sin(0.02), np.cos(0.02)]])
    posed = [
        replace(frame, points=frame.points @ turn + [3.0 * number, 0.1 * number]) if number % 2 else frame
        for number, frame in enumerate(frames)
    ]
    plain, moved = (AlignedOutlines.of(each).silhouette(walls, 1) for each in (frames, posed))
    apart = residuals(moved, plain.points)[1] * HALF_WIDTH
    assert np.sqrt(np.mean(apart**2)) < 0.06
    assert moved.noise.scale == pytest.approx(plain.noise.scale, rel=0.1)
    mirrored = AlignedOutlines.of(frames).silhouette(walls, -1).points * [-1.0, 1.0]
    assert np.ptp(mirrored, axis=0) == pytest.approx(np.ptp(plain.points, axis=0), abs=1e-9)


EXAMPLE = Path(__file__).parents[2] / "examples/pictures"
OF_EXAMPLE = Experiment.read(EXAMPLE / "experiment.toml")
EXAMPLE_TRUTH = tomllib.loads((EXAMPLE / "truth.toml").read_text())
LENGTHS = np.array([EXAMPLE_TRUTH["axial_extent_over_l"], EXAMPLE_TRUTH["axial_length_over_l"]])


@functools.cache
def example():
    video = cv2.VideoCapture(str(EXAMPLE / "film.avi"))
    return [cv2.cvtColor(video.read()[1], cv2.COLOR_BGR2GRAY) for _ in range(13)]


def of_pages(path, frames, **options):
    """Measure a film of some frames, as one TIFF file."""
    cv2.imwritemulti(str(path / "film.tif"), list(frames))
    return measure_film(path / "film.tif", OF_EXAMPLE, **options)


def off(capsule, lengths=LENGTHS):
    """Largest error of the lengths over the one that is stated."""
    return np.max(np.abs(capsule.measurement.lengths - lengths) / np.sqrt(np.diag(capsule.measurement.covariance)))


@pytest.mark.parametrize("count", range(5, 14))
def test_the_first_and_the_last_frames_of_a_film_are_right_or_refused(tmp_path, count):
    """In few frames the median still shows the capsule, where it covers a place in almost half of them."""
    for first in {0, 13 - count}:
        made = of_pages(tmp_path, example()[first : first + count])
        if count < 9:
            assert made.status is Status.COVERED
            continue
        (capsule,) = made.capsules
        assert capsule.status is Status.DONE
        assert off(capsule) < 2.0
        assert not any(capsule.drifts[name].significant for name in ("L_z", "L_a"))
        assert capsule.table()["alike"].sum() == count


@pytest.mark.parametrize("share", [0.5, 0.7])
def test_a_video_that_breaks_off_is_refused(tmp_path, share):
    whole = (EXAMPLE / "film.avi").read_bytes()
    (tmp_path / "film.avi").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InputError, match=rf"a whole AVI file, got {int(share * len(whole))} of its {len(whole)} bytes"):
        measure_film(tmp_path / "film.avi", OF_EXAMPLE)


def test_parts_of_a_film_of_two_capsules_are_right_or_refused(tmp_path):
    """The second capsule is seven steps behind the first."""
    both = film(24.0 * np.arange(-1, 20)[:, None] - [0.0, 168.0], 3)
    done = []
    for first, count in ((1, 9), (2, 12), (4, 12), (0, 15), (1, 19)):
        made = of_pages(tmp_path, both[first : first + count])
        measured = [capsule for capsule in made.capsules if capsule.status.ok]
        assert all(off(capsule, DRAWN) < 2.5 for capsule in measured)
        done.append(len(measured))
    assert done[-1] == 2


NUMBER = np.arange(13)


@pytest.mark.parametrize(
    "factors",
    [
        0.85 * (1.0 + 0.2 * np.random.default_rng(1).uniform(-1.0, 1.0, 13)),
        np.where(NUMBER % 2, 0.9, 0.75),
        1.0 - 0.03 * NUMBER,
    ],
    ids=["random", "by turns", "fading"],
)
def test_the_light_of_the_lamp_does_not_matter(tmp_path, factors):
    frames = [counts(frame * factor) for frame, factor in zip(example(), factors, strict=True)]
    (capsule,), (steady,) = (of_pages(tmp_path, each).capsules for each in (frames, example()))
    assert capsule.status is Status.DONE
    np.testing.assert_allclose(capsule.measurement.lengths, steady.measurement.lengths, atol=0.001)
    assert capsule.alike.all()


def test_a_background_of_another_brightness_and_capsules_that_cover_most_of_a_picture_do_not_matter(tmp_path):
    """The light of a frame is not that of the capsules in it."""
    for factor in (0.5, 0.8, 1.1):
        (capsule,) = of_pages(tmp_path, example(), background=counts(np.median(example(), axis=0) * factor)).capsules
        assert capsule.status is Status.DONE
        assert off(capsule) < 2.0
    part = slice(8, 110), slice(100, 250)
    frames = [frame[part] for frame in film(np.arange(155.0, 196.0, 8.0), 2)]
    (capsule,) = of_pages(tmp_path, frames, background=EMPTY[part]).capsules
    assert off(capsule, DRAWN) < 2.5


@pytest.mark.parametrize("other", ["exposure", "fluorescence", "dark field", "a frame dropped"])
def test_two_channels_that_take_turns_are_named(tmp_path, other):
    empty = np.median(example(), axis=0)
    frames = {
        "fluorescence": [counts(10.0 + np.clip(empty - frame, 0.0, None)) for frame in example()],
        "dark field": [255 - frame for frame in example()],
    }.get(other, [counts(0.5 * frame) for frame in example()])
    mixed = [own if number % 2 else plain for number, (own, plain) in enumerate(zip(frames, example(), strict=True))]
    if other == "a frame dropped":
        del mixed[5]
    assert of_pages(tmp_path, mixed).status is Status.TAKE_TURNS
    assert "split the film" in str(Status.TAKE_TURNS)
    (capsule,) = of_pages(tmp_path, example()[::2] + example()[1::2][:2], flow="right").capsules[:1]
    assert capsule.status is not Status.TAKE_TURNS


@pytest.mark.parametrize("step", [1.5, 6.0, 23.37])
def test_interlaced_frames_are_named(tmp_path, step):
    """The even rows of a frame show the capsule half a step further downstream than the odd ones."""
    places = 90.0 + step * np.arange(6)
    odd, even = film(places, 1), film(places + 0.5 * step, 2)
    rows = np.arange(SHAPE[0])[:, None] % 2 == 0
    frames = [np.where(rows, late, early) for early, late in zip(odd, even, strict=True)]
    (capsule,) = of_pages(tmp_path, frames, background=EMPTY).capsules
    assert capsule.status is Status.INTERLACED
    assert detect(Picture.from_array(frames[2])).status is Status.INTERLACED
    assert detect(Picture.from_array(odd[2])).status is Status.DONE


def test_a_significant_change_of_one_length_is_in_the_errors_of_both(tmp_path, monkeypatch):
    (plain,) = of_pages(tmp_path, example()).capsules
    changes = iter([Drift(0.003, 0.0015), Drift(0.008, 0.002)])
    monkeypatch.setattr("capsbayes.image.film_capsule.drift", lambda *_: next(changes))
    (changing,) = of_pages(tmp_path, example()).capsules
    assert changing.status is Status.DONE
    widened = np.sqrt(np.diag(changing.measurement.covariance) - np.diag(plain.measurement.covariance))
    np.testing.assert_allclose(widened / plain.measurement.lengths, [0.003, 0.008], rtol=0.02)


def scaled(grey, factor, degrees=0.0):
    rows, columns = grey.shape
    move = cv2.getRotationMatrix2D((0.5 * (columns - 1), 0.5 * (rows - 1)), degrees, factor)
    return cv2.warpAffine(grey, move, (columns, rows), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


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
        (lambda empty: counts(empty * 0.1), "darker"),
    ],
)
@pytest.mark.parametrize("contrast", ["dark", "bright"])
def test_a_background_that_does_not_fit_the_film_is_named(tmp_path, changed, message, contrast):
    frames = example() if contrast == "dark" else [255 - frame for frame in example()]
    empty = changed(np.median(frames, axis=0).astype(np.uint8))
    empty = 255 - empty if contrast == "bright" and empty is example()[4] else empty
    with pytest.raises(InputError, match=f"background: expected .*{message}.*, or leave the background out"):
        of_pages(tmp_path, frames, background=empty)


FRAMES = np.array([0.0, 1.0, 2.0, 4.0, 5.0, 6.0, 8.0, 9.0])  # two frames could not be read
NOISE = 0.05


def fitted(seed, acceleration=0.0):
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(FRAMES))
    places = 50.0 - 12.3 * FRAMES - 0.5 * acceleration * FRAMES**2 + noise
    return velocity(FRAMES, places, np.full(len(FRAMES), NOISE**2))


def test_the_velocity_lies_within_its_error_and_a_capsule_that_speeds_up_is_seen_to():
    fits = [fitted(seed) for seed in range(400)]
    z = np.array([(fit.value + 12.3) / fit.error for fit in fits])
    assert z.std() == pytest.approx(1.0, abs=0.12)
    assert abs(z.mean()) < 0.15
    assert np.mean([fit.drift.significant for fit in fits]) < 0.02
    faster = fitted(1, acceleration=0.1).drift
    assert faster.change == pytest.approx(0.9 / 12.75, rel=0.15)
    assert abs(faster.change) / faster.error > 10.0
    assert faster.unsteady
    three = velocity(np.arange(3.0), np.array([0.0, 5.0, 10.0]), np.full(3, NOISE**2))
    assert three.value == pytest.approx(5.0)
    assert three.error == pytest.approx(NOISE / np.sqrt(2.0))  # no scatter at all is chance
    assert three.drift is None


@pytest.mark.parametrize(("slope", "unsteady"), [(0.0, False), (1e-4, False), (1e-2, True)])
def test_a_length_that_changes_along_the_channel(slope, unsteady):
    along = 10.0 * FRAMES[::-1]
    lengths = 80.0 + slope * along + 0.02 * np.random.default_rng(2).standard_normal(len(along))
    change = drift(along, lengths, np.full(len(along), 4e-4))
    assert change.change == pytest.approx(-slope * 90.0 / 80.0, abs=3.0 * change.error)
    assert change.unsteady is unsteady


def test_the_times_of_dropped_and_repeated_frames_follow_from_the_steps():
    number, variance = np.arange(12.0), np.full(12, 0.01)
    true = np.array([0, 1, 2, 4, 5, 5, 6, 7, 10, 11, 12, 13.0])
    noise = 0.1 * np.random.default_rng(1).standard_normal(12)
    np.testing.assert_array_equal(times_of(number, 7.0 - 9.0 * true + noise, variance), true)
    np.testing.assert_array_equal(times_of(number, 0.3 * true + noise, variance), number)  # within the errors
    np.testing.assert_array_equal(times_of(number, 9.0 * true + 4.0 * (number > 6), variance), number)  # no multiple
    np.testing.assert_array_equal(times_of(2.0 * number, 18.0 * number, variance), 2.0 * number)
