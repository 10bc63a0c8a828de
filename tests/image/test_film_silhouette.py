"""The silhouette of a film, compared with the drawn one and with those of its frames."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
from drawn_film import HALF_WIDTH, bright, exposed, film, written

from capsbayes.experiment import Experiment
from capsbayes.image.files import Picture
from capsbayes.image.film import FilmMeasurement, measure_film
from capsbayes.image.film_capsule import AlignedOutlines, FrameOutline
from capsbayes.image.measure import detect, silhouette_of
from capsbayes.infer.outline import aligned_with
from capsbayes.measurement import Measurement
from capsbayes.profile import signed_area
from capsbayes.status import Status

EXPERIMENT = Experiment(cross_section="square", half_width=25e-6, viscosity=0.85)
PLACES = 65.0 + 23.37 * np.arange(9)
TRUTH = bright(x=PLACES[0]).scene.silhouette
NOISY = 1500.0


def measured(folder, frames):
    background = bright(x=PLACES[0]).background
    (capsule,) = measure_film(written(folder, frames), EXPERIMENT, frame_rate="2000 Hz", background=background).capsules
    return capsule


def detections(frames, **scene):
    background = Picture.from_array(bright(x=PLACES[0], **scene).background)
    return [detect(Picture.from_array(frame), background=background) for frame in frames]


def residuals(outline, truth=TRUTH):
    points, feet = aligned_with(outline.points, truth if signed_area(truth) > 0.0 else truth[::-1])
    return points, feet.distance


def misfit(outline):
    points, distance = residuals(outline)
    covariance = outline.noise.covariance(points) + outline.pose.offset**2
    factor = scipy.linalg.cholesky(covariance, lower=True)
    return np.mean(scipy.linalg.solve_triangular(factor, distance, lower=True) ** 2)


def speck(grey, x, y, radius=6.0):
    yy, xx = np.mgrid[: grey.shape[0], : grey.shape[1]]
    return grey * (1.0 - 0.5 * (np.hypot(xx - x, yy - y) < radius))


def test_the_mean_of_the_frames_is_nearer_to_the_truth_than_any_frame_and_says_so(tmp_path):
    squares = []
    for seed in range(4):
        frames = film(PLACES, seed, electrons=NOISY)
        together = measured(tmp_path / str(seed), frames).measurement.outline
        alone = [silhouette_of(found) for found in detections(frames)]
        errors = [np.std(residuals(outline)[1]) for outline in alone]
        assert np.std(residuals(together)[1]) < 0.7 * min(errors)
        assert together.noise.scale < 0.85 * min(outline.noise.scale for outline in alone)
        assert together.pose.offset < 1.1 * min(outline.pose.offset for outline in alone)
        squares.append(misfit(together))
    assert 0.2 < np.mean(squares) < 1.5


def test_what_all_frames_share_is_not_averaged_away(tmp_path):
    """Without noise, more frames hardly tell more: the misfit of the edge's model stays."""
    few, many = (measured(tmp_path / str(n), film(PLACES[:n], 1, electrons=1e7)).measurement.outline for n in (4, 9))
    assert many.noise.scale == pytest.approx(few.noise.scale, rel=0.3)
    assert many.noise.scale * HALF_WIDTH > 0.01
    assert many.pose.offset == pytest.approx(few.pose.offset, rel=0.05)


def test_frames_with_a_fault_are_left_out_of_outline_and_lengths(tmp_path):
    """A speck lies on the nose in one frame, and beside a flank in another."""
    frames = film(PLACES, 2)
    whole = measured(tmp_path / "whole", frames)
    nose = 0.5 * bright(x=PLACES[0]).axial_extent
    spoilt = list(frames)
    spoilt[3] = exposed(speck(frames[3].astype(float), PLACES[3] + nose, 58.5), 1)
    spoilt[6] = exposed(speck(frames[6].astype(float), PLACES[6], 58.5 - 0.8 * HALF_WIDTH), 1)
    found = measured(tmp_path / "spoilt", spoilt)
    assert found.status is Status.DONE
    assert whole.alike.all()
    numbers = [frame.frame for frame, alike in zip(found.record.measured, found.alike, strict=True) if alike]
    assert numbers == [0, 1, 2, 4, 5, 7, 8]
    assert found.measurement.axial_extent == pytest.approx(whole.measurement.axial_extent, abs=0.002)
    assert misfit(found.measurement.outline) < 2.0
    assert found.table()["alike"].sum() == 7
    counted = FilmMeasurement(Status.DONE, (found,)).table().loc[0, ["frames", "alike"]].tolist()
    assert counted == [len(found.record.measured), 7]


def test_many_frames_that_disagree_are_no_steady_capsule(tmp_path):
    frames = film(PLACES, 2)
    nose = 0.5 * bright(x=PLACES[0]).axial_extent
    for number in (1, 4, 6):
        frames[number] = exposed(speck(frames[number].astype(float), PLACES[number] + nose, 58.5), 1)
    assert measured(tmp_path / "film", frames).status in (Status.UNSTEADY, Status.FEW_FRAMES)


def test_blurred_frames_do_not_widen_the_noise():
    found = detections(film(PLACES, 3))
    outlines = [FrameOutline.of(each) for each in found]
    dull = replace(outlines[0].errors, misfit=0.3, offset=0.3)
    mixed = AlignedOutlines.of([*outlines[:6], *(replace(each, errors=dull) for each in outlines[6:])])
    assert len(mixed.sharpest()) <= 6
    sharp = AlignedOutlines.of(outlines[:6])
    walls = found[0].walls
    assert mixed.sharpest().silhouette(walls, 1).noise.scale < 1.2 * sharp.silhouette(walls, 1).noise.scale


def test_shift_turn_and_direction_leave_the_silhouette_as_it_is():
    found = detections(film(PLACES, 4))
    outlines = [FrameOutline.of(each) for each in found]
    turn = np.array([[np.cos(0.02), np.sin(0.02)], [-np.sin(0.02), np.cos(0.02)]])
    posed = [
        replace(each, points=each.points @ turn + [3.0 * number, 0.1 * number]) if number % 2 else each
        for number, each in enumerate(outlines)
    ]
    walls = found[0].walls
    plain, moved = (AlignedOutlines.of(each).silhouette(walls, 1) for each in (outlines, posed))
    apart = aligned_with(moved.points, plain.points)[1].distance * HALF_WIDTH
    assert np.sqrt(np.mean(apart**2)) < 0.06
    assert moved.noise.scale == pytest.approx(plain.noise.scale, rel=0.1)
    left = AlignedOutlines.of(outlines).silhouette(walls, -1)
    mirrored = left.points * [-1.0, 1.0]
    assert np.ptp(mirrored, axis=0) == pytest.approx(np.ptp(plain.points, axis=0), abs=1e-9)


def test_a_change_along_the_channel_is_part_of_the_error():
    found = detections(film(PLACES, 5))
    together = AlignedOutlines.of([FrameOutline.of(each) for each in found])
    steady, changing = (together.silhouette(found[0].walls, 1, change) for change in (0.0, 0.5))
    assert changing.noise.scale * HALF_WIDTH == pytest.approx(np.hypot(steady.noise.scale * HALF_WIDTH, 0.5), rel=0.01)


def test_the_file_of_a_capsule_holds_its_silhouette(tmp_path):
    capsule = measured(tmp_path / "film", film(PLACES, 6))
    capsule.measurement.write(tmp_path / "measurement.toml")
    read = Measurement.read(tmp_path / "measurement.toml").outline
    assert read.view == "silhouette"
    assert np.allclose(read.points, capsule.measurement.outline.points, atol=1e-8)
    assert read.noise == capsule.measurement.outline.noise
