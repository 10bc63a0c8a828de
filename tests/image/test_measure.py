import cv2
import numpy as np
import pytest
from drawn import HALF_WIDTH, circle, drawn

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.image.files import Picture
from capsbayes.image.measure import detect, measure
from capsbayes.image.synthetic import Optics, Scene, draw
from capsbayes.quantity import Quantity
from capsbayes.status import Status

EXPERIMENT = Experiment(cross_section="square", half_width=25e-6, viscosity=0.85)
VELOCITY = Quantity(6e-3, 6e-5, "m/s")
BLURRED = Optics(blur=2.0, halo=0.05, electrons=5000)
UNEVEN = Optics(blur=1.0, motion=1.5, halo=0.08, vignetting=0.25, unevenness=0.1, electrons=5000)


def seen(made, *, flow=None, background=True):
    empty = Picture.from_array(made.background) if background else None
    return detect(Picture.from_array(made.picture), background=empty, flow=flow)


@pytest.mark.parametrize(("optics", "tolerance"), [(Optics(), 0.2), (UNEVEN, 0.35), (BLURRED, 0.6)])
@pytest.mark.parametrize("background", [True, False])
@pytest.mark.parametrize("scene", [{}, {"tilt": 0.03, "flow": -1, "centre": (102.3, 97.1)}])
def test_lengths_of_a_parachute(optics, tolerance, background, scene):
    made = drawn(0.08, 1.05, optics=optics, half_width=55.0, **scene)
    found = seen(made, background=background)
    assert found.status is Status.DONE
    assert found.flow == made.scene.flow
    truth = [made.axial_extent, made.axial_length, made.axial_extent - made.axial_length, made.half_width]
    np.testing.assert_allclose(found.lengths, truth, atol=tolerance)
    errors = np.sqrt(np.diag(found.covariance))
    assert np.all((errors > 0.01) & (errors < tolerance))
    assert np.all(np.linalg.eigvalsh(found.covariance) > -1e-12)


def test_the_outline_lies_on_the_truth_not_half_a_pixel_inside():
    disc = circle(0.8)
    made = draw(Scene(disc, disc, half_width=HALF_WIDTH), Optics(), seed=2)
    found = seen(made)
    radius = np.hypot(*(found.outline.points - made.scene.middle).T)
    assert radius.mean() == pytest.approx(0.8 * HALF_WIDTH, abs=0.05)
    assert radius.std() < 0.15
    assert found.flow == 0
    assert found.rear is None


@pytest.mark.parametrize("blur", [0.8, 1.4, 2.0])
def test_edge_widths_witness_the_blur(blur):
    outline = seen(drawn(0.1, 0.9, optics=Optics(blur=blur, electrons=50_000))).outline
    front = np.median(outline.edge_width[outline.normals[:, 0] > 0.9])
    assert front == pytest.approx(np.hypot(blur, np.sqrt(1.0 / 12.0)), rel=0.15)  # and the size of a pixel


def test_a_convex_rear_gives_a_bound_not_a_length():
    made = drawn(0.03, 0.75)
    measured = measure(made.picture, EXPERIMENT, capsule_velocity=VELOCITY, background=made.background)
    assert measured.status is Status.DONE
    assert measured.axial_length is None
    assert made.axial_length / HALF_WIDTH < measured.axial_length_bound < 1.02 * measured.axial_extent
    assert measured.covariance.shape == (1, 1)


def test_a_measurement_is_over_l_with_the_errors_of_both(tmp_path):
    made = drawn(0.08, 1.05, half_width=55.0)
    for name in ("picture", "background"):
        cv2.imwrite(str(tmp_path / f"{name}.png"), getattr(made, name))
    measured = measure(
        tmp_path / "picture.png", EXPERIMENT, capsule_velocity=VELOCITY, background=tmp_path / "background.png"
    )
    detection = seen(made)
    assert measured.over_half_width
    np.testing.assert_allclose(measured.lengths, detection.lengths[:2] / detection.lengths[3])
    share = np.sqrt(np.diag(measured.covariance)) / measured.lengths
    of_walls = np.sqrt(detection.covariance[3, 3]) / detection.lengths[3]
    np.testing.assert_allclose(
        share, np.hypot(np.sqrt(np.diag(detection.covariance))[:2] / detection.lengths[:2], of_walls)
    )
    assert 0.0 < measured.length_correlation < 1.0
    assert measured.source.endswith("picture.png")
    assert len(measured.sha256) == 64


def spoilt(kind):
    made = drawn(0.1, 0.9, half_width=50.0, shape=(200, 300), centre=(90.0, 99.5))
    picture, background = made.picture.copy(), made.background.copy()
    match kind:
        case "nothing":
            picture = made.background
        case "walls":
            picture[:] = background[:] = 150
        case "border":
            picture, background = picture[:, 60:], background[:, 60:]
        case "two":
            second = drawn(0.1, 0.9, half_width=50.0, shape=(200, 300), centre=(220.0, 99.5))
            picture[:, 155:] = second.picture[:, 155:]
        case "saturated":
            picture = np.clip(picture.astype(int) * 3, 0, 255).astype(np.uint8)
        case "size":
            background = background[:, :-1]
    return picture, background


@pytest.mark.parametrize(
    ("kind", "status"),
    [
        ("nothing", Status.NO_CAPSULE),
        ("walls", Status.NO_WALLS),
        ("border", Status.TOUCHES_BORDER),
        ("two", Status.SEVERAL_CAPSULES),
        ("saturated", Status.SATURATED),
        ("size", Status.BACKGROUND_DIFFERS),
    ],
)
def test_what_cannot_be_measured_ends_with_a_named_status(kind, status):
    picture, background = spoilt(kind)
    measured = measure(picture, EXPERIMENT, capsule_velocity=VELOCITY, background=background)
    assert measured.status is status
    assert np.isnan(measured.axial_extent)
    assert np.all(np.isnan(measured.lengths))


def test_a_wrong_flow_is_refused():
    made = drawn(0.1, 0.9, flow=-1)
    assert seen(made, flow="right").status is Status.WRONG_FLOW
    assert seen(made, flow="left").status is Status.DONE
    with pytest.raises(InputError, match='expected "right" or "left"'):
        seen(made, flow="up")


@pytest.mark.parametrize(("exposure", "status"), [("0.1 ms", Status.DONE), ("1 ms", Status.SMEARED)])
def test_a_stated_exposure_in_which_the_capsule_moves_far_is_refused(exposure, status):
    """At 6 mm/s and 25 um to 60 px it moves by 1.4 px in 0.1 ms, by 14 px in 1 ms."""
    made = drawn(0.05, 0.8)
    known = Experiment(cross_section="square", half_width=25e-6, viscosity=0.85, exposure=exposure)
    found = measure(made.picture, known, capsule_velocity=VELOCITY, background=made.background)
    assert found.status is status
    assert (found.outline is None) == (status is Status.SMEARED)


def test_errors_grow_with_the_noise():
    quiet, noisy = (
        np.sqrt(seen(drawn(0.08, 1.05, half_width=55.0, optics=Optics(electrons=count))).covariance[0, 0])
        for count in (50_000, 1500)
    )
    assert noisy > 1.5 * quiet


def test_the_table_holds_lengths_and_integrals_over_l():
    made = drawn(0.05, 0.8)
    found = detect(Picture.from_array(made.picture), background=Picture.from_array(made.background))
    table = found.table()
    assert list(table.index) == ["L_z", "L_a", "L_p", "l", "perimeter", "area", "volume", "Lambda"]
    np.testing.assert_allclose(table["value_px"].iloc[:4], found.lengths)
    assert table.loc["area", "value_over_l"] == pytest.approx(found.integrals.area.value / found.lengths[3] ** 2)
    assert table.loc["l", ["value_over_l", "error_over_l"]].tolist() == [1.0, 0.0]
    assert table.loc["Lambda", "error_over_l"] == pytest.approx(found.integrals.stretch_ratio.error)
