import numpy as np
import pytest
from drawn_film import HALF_WIDTH, SHAPE, bright, exposed, film, written

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.image.by_hand import ByHand
from capsbayes.image.files import Film
from capsbayes.image.film import FilmMeasurement, measure_film
from capsbayes.quantity import Quantity
from capsbayes.status import Status

EXPERIMENT = Experiment(cross_section="square", half_width=25e-6, viscosity=0.85)
RATE = Quantity(2000.0, 0.0, "1/s")
STEP = 23.37  # px per frame
PLACES = 65.0 + STEP * np.arange(9)
IN_SI = STEP / HALF_WIDTH * 25e-6 * 2000.0


def empty():
    return bright(x=PLACES[0]).background


def measured(folder, frames, **options):
    given = {"background": empty()} | options
    return measure_film(written(folder, frames), EXPERIMENT, frame_rate=RATE, **given)


def disc(grey, x, y, radius):
    yy, xx = np.mgrid[: SHAPE[0], : SHAPE[1]]
    away = np.hypot(xx - x, yy - y) - radius
    return grey * (1.0 - 0.4 / (1.0 + np.exp(np.clip(1.5 * away, -50.0, 50.0))))


def test_velocity_and_lengths_lie_within_their_errors(tmp_path):
    """In pixels the velocity's error is that of the centroid's place; in metres that of the half width leads."""
    truth = np.array([bright(x=PLACES[0]).axial_extent, bright(x=PLACES[0]).axial_length]) / HALF_WIDTH
    z, of_lengths, in_si = [], [], []
    for seed in range(5):
        made = measured(tmp_path / str(seed), film(PLACES, seed))
        (capsule,) = made.capsules
        assert capsule.status is Status.DONE
        assert len(capsule.record.measured) == len(PLACES)
        seen = capsule.measurement
        z.append((capsule.velocity.value - STEP) / capsule.velocity.error)
        of_lengths.append((seen.lengths - truth) / np.sqrt(np.diag(seen.covariance)))
        assert seen.axial_length is not None
        in_si.append((seen.capsule_velocity - IN_SI) / seen.capsule_velocity_error)
        assert capsule.velocity.error < 2e-4 * STEP
    assert 0.2 < np.sqrt(np.mean(np.square(z))) < 1.6
    assert np.max(np.abs(of_lengths)) < 2.5
    assert np.max(np.abs(in_si)) < 2.5


@pytest.mark.parametrize("kept", [[0, 1, 3, 4, 5, 8], [0, 1, 1, 2, 3, 4, 5]], ids=["dropped", "repeated"])
def test_frames_that_were_dropped_or_repeated_leave_the_velocity_right(tmp_path, kept):
    made = film(PLACES, 1)
    (capsule,) = measured(tmp_path / "film", [made[number] for number in kept]).capsules
    assert capsule.status is Status.DONE
    assert abs(capsule.velocity.value - STEP) < 4.0 * capsule.velocity.error
    assert capsule.velocity.error < 1e-3 * STEP


@pytest.mark.parametrize("count", [8, 9])
@pytest.mark.parametrize("noise", [0.0, 0.4])
def test_a_film_in_which_most_frames_are_copies_is_refused(tmp_path, count, noise):
    """Their errors would not be independent, and the step from frame to frame may be that of one frame or of two."""
    rng = np.random.default_rng(1)
    twice = [frame + noise * rng.standard_normal(SHAPE) for frame in film(PLACES, 1) for _ in range(2)]
    frames = [np.clip(np.rint(frame), 0, 255).astype(np.uint8) for frame in twice]
    (capsule,) = measured(tmp_path / "film", frames[:count]).capsules
    assert capsule.status is capsule.measurement.status is Status.REPEATED


@pytest.mark.parametrize(("exposure", "status"), [("20 us", Status.DONE), ("150 us", Status.SMEARED)])
def test_a_capsule_that_moves_by_more_than_three_pixels_in_the_exposure_is_refused(tmp_path, exposure, status):
    """It moves by 0.93 px in 20 us at 2000 pictures in a second, by 7 px in 150 us."""
    folder = written(tmp_path / "film", film(PLACES))
    known = Experiment(cross_section="square", half_width=25e-6, viscosity=0.85, exposure=exposure)
    (capsule,) = measure_film(folder, known, frame_rate=RATE, background=empty()).capsules
    assert capsule.status is status
    assert capsule.measurement.status is status


def test_the_error_of_the_half_width_is_in_the_velocity(tmp_path):
    folder = written(tmp_path / "film", film(PLACES))
    known = Experiment(cross_section="square", half_width=Quantity(25e-6, 0.5e-6), viscosity=0.85)
    (capsule,) = measure_film(folder, known, frame_rate=Quantity(2000.0, 20.0, "1/s"), background=empty()).capsules
    seen = capsule.measurement
    assert seen.capsule_velocity_error / seen.capsule_velocity == pytest.approx(np.hypot(0.02, 0.01), rel=0.02)


def test_the_mean_has_less_noise_than_one_frame_and_the_same_misfit(tmp_path):
    noisy = film(PLACES, 3, electrons=1000.0)
    (capsule,) = measured(tmp_path / "film", noisy).capsules
    one = capsule.record.measured[0]
    alone, lasting = (one.covariance - one.systematic)[0, 0], one.systematic[0, 0]
    of_walls = one.covariance[3, 3] * capsule.measurement.axial_extent**2
    mean = capsule.measurement.covariance[0, 0] * HALF_WIDTH**2 - of_walls
    assert 0.9 * lasting < mean < lasting + 0.5 * alone
    assert 0.2 < capsule.repeat_error[0] / np.sqrt(alone) < 1.5


def test_everything_in_a_film_is_a_capsule_or_has_a_reason(tmp_path):
    """A capsule, two that overlap and a speck behind it; each is cut by the border for a while."""
    frames = []
    for number, x in enumerate(np.arange(PLACES[0] - 4.0 * STEP, 700.0, STEP)):
        grey = empty().astype(float)
        if x < SHAPE[1] + 55.0:
            one = bright(x=float(x))
            grey = one.picture.astype(float)
        for behind, radius in ((110.0, 6.0), (190.0, 18.0), (217.0, 18.0)):
            grey = disc(grey, x - behind, 58.5, radius)
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
    made = measure_film(folder, EXPERIMENT, frame_rate=RATE, background=empty())
    assert (made.frames, made.unreadable) == (9, 1)
    assert made.capsules[0].velocity.value == pytest.approx(STEP, abs=0.01)
    assert len(made.capsules[0].record.measured) == 8


@pytest.mark.parametrize(
    ("places", "status"), [(PLACES[:2], Status.FEW_FRAMES), (np.full(4, PLACES[3]), Status.COVERED)]
)
def test_what_a_film_cannot_tell_has_a_status(tmp_path, places, status):
    background = None if status is Status.COVERED else empty()
    made = measured(tmp_path / "film", film(places), background=background)
    assert status in (made.status, *(capsule.status for capsule in made.capsules))


def test_light_that_fades_along_the_channel_covers_nothing(tmp_path):
    """Vignetting darkens the ends of the field by a fifth: the median is the empty channel all the same."""
    along = np.linspace(-1.0, 1.0, SHAPE[1])
    places = np.arange(-60.0, SHAPE[1] + 60.0, STEP)
    faded = [(frame * (1.0 - 0.2 * along**2)).astype(np.uint8) for frame in film(places)]
    (capsule,) = measured(tmp_path / "film", faded, background=None).capsules
    assert capsule.status is Status.DONE
    assert capsule.velocity.value == pytest.approx(STEP, abs=0.02)
    stuck = [(frame * (1.0 - 0.2 * along**2)).astype(np.uint8) for frame in film(np.full(4, PLACES[3]))]
    assert measured(tmp_path / "stuck", stuck, background=None).status is Status.COVERED


def test_the_other_direction_is_refused(tmp_path):
    made = measured(tmp_path / "film", film(PLACES), flow="left")
    assert {capsule.status for capsule in made.capsules} == {Status.WRONG_FLOW}
    with pytest.raises(InputError, match='expected "right" or "left"'):
        measured(tmp_path / "again", film(PLACES), flow="up")


def test_a_capsule_that_lengthens_is_unsteady(tmp_path):
    """The second half of the film is of the same capsule at a higher capillary number."""
    frames = [film([x], capillary_number=0.06 if x < 150.0 else 0.08)[0] for x in PLACES]
    (capsule,) = measured(tmp_path / "film", frames).capsules
    assert capsule.status is Status.UNSTEADY
    assert capsule.drifts["L_z"].unsteady


def test_tables_hold_the_capsules_and_their_frames(tmp_path):
    made = measured(tmp_path / "film", film(PLACES))
    table, (capsule,) = made.table(), made.capsules
    assert table.loc[0, ["capsule", "status", "frames"]].tolist() == [1, "DONE", len(PLACES)]
    assert table.loc[0, "velocity_m_s"] == capsule.measurement.capsule_velocity
    assert table.loc[0, "L_z_change"] == capsule.drifts["L_z"].change
    assert capsule.table()["frame"].tolist() == list(range(len(PLACES)))
    assert list(FilmMeasurement(Status.NO_WALLS).table().columns) == list(table.columns)


def test_a_stated_contrast_gives_the_same_from_the_first_frames(tmp_path, monkeypatch):
    asked = []
    spread = Film.spread
    monkeypatch.setattr(Film, "spread", lambda film, count: asked.append(count) or spread(film, count))
    frames = film(PLACES, 1)
    found = measured(tmp_path / "found", frames)
    stated = measured(tmp_path / "stated", frames, by_hand=ByHand(contrast="dark"))
    assert len(asked) == 1  # the contrast is sought in frames spread over the film
    for one, other in zip(found.capsules, stated.capsules, strict=True):
        assert one.status is Status.DONE
        np.testing.assert_allclose(one.measurement.lengths, other.measurement.lengths, rtol=1e-6)
