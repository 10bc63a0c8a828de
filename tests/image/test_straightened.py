"""Pictures through a camera with faults, made by moving the pixels of drawn ones."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from drawn import HALF_WIDTH, drawn, shapes

from capsbayes.errors import InputError
from capsbayes.experiment import Camera, Experiment
from capsbayes.image.by_hand import ByHand
from capsbayes.image.contour import ContourFile, measure_contour
from capsbayes.image.measure import measure, measurement_of_lengths
from capsbayes.image.synthetic import Optics
from capsbayes.infer.outline import aligned_with
from capsbayes.quantity import Quantity

EXPERIMENT = Experiment(cross_section="square", half_width=25e-6, viscosity=0.85)
VELOCITY = Quantity(6e-3, 6e-5, "m/s")
FAULTS = {"pixel_aspect": 1.03, "distortion": -0.006, "taper": 0.01}


def photographed(picture, name, size):
    """Return the picture that a camera with a fault takes: where each of its pixels looks in the true picture."""
    rows, columns = picture.shape
    y, x = np.mgrid[:rows, :columns].astype(float)
    middle = np.array([0.5 * (columns - 1), 0.5 * (rows - 1)])
    away = (np.stack([x, y], axis=-1) - middle) / HALF_WIDTH
    if name == "pixel_aspect":
        away = away / [size, 1.0]
    elif name == "distortion":  # seen at r (1 + size r^2); Newton's method for r
        seen = radius = np.hypot(away[..., 0], away[..., 1])
        for _ in range(20):
            radius = radius - (radius * (1.0 + size * radius**2) - seen) / (1.0 + 3.0 * size * radius**2)
        away = away * (radius / np.maximum(seen, 1e-9))[..., None]
    else:
        away = away / (1.0 + size * away[..., :1])
    source = (away * HALF_WIDTH + middle).astype(np.float32)
    return cv2.remap(picture, source[..., 0], source[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def walls_seen(name, size, columns):
    """Return what is stated of the walls, which are bent or open: their mean along the picture."""
    along = (np.arange(columns) - 0.5 * (columns - 1)) / HALF_WIDTH
    wider = {"pixel_aspect": 0.0 * along, "distortion": size * (1.0 + along**2), "taper": size * along}[name]
    half = HALF_WIDTH * (1.0 + wider.mean())
    return ByHand(walls=(99.5 - half, 99.5 + half))


@pytest.mark.parametrize("flow", [1, -1])
@pytest.mark.parametrize("name", FAULTS)
def test_a_stated_fault_is_taken_out(name, flow):
    size = FAULTS[name]
    made = drawn(0.08, 1.0, flow=flow, shape=(200, 320), centre=(180.0, 99.5), optics=Optics(electrons=20_000))
    picture, empty = (photographed(it, name, size) for it in (made.picture, made.background))
    camera = Camera(**{name: f"{size!r} +/- 0.002"})
    options = {"capsule_velocity": VELOCITY, "background": empty, "by_hand": walls_seen(name, size, 320)}
    faulty = measure(picture, EXPERIMENT, **options)
    found = measure(picture, replace(EXPERIMENT, camera=camera), **options)
    truth = np.array([made.axial_extent, made.axial_length]) / HALF_WIDTH
    np.testing.assert_allclose(found.lengths, truth, atol=0.006)
    shape = np.asarray(made.scene.silhouette)
    assert np.abs(aligned_with(found.outline.points, shape)[1].distance).max() < 0.012
    before, after = (aligned_with(it.outline.points, shape)[1].distance.std() for it in (faulty, found))
    assert after < 0.6 * before
    assert getattr(found.outline.pose, name) == pytest.approx(0.002)
    assert found.outline.pose.middle == pytest.approx(flow * (180.0 - 159.5) / HALF_WIDTH, abs=0.05)
    assert np.all(np.diag(found.covariance) >= np.diag(faulty.covariance) * 0.9)


def test_an_uncertain_camera_makes_lengths_uncertain():
    made = drawn(0.08, 1.0)
    camera = Camera(pixel_aspect="1.00 +/- 0.01")
    plain, found = (
        measure(made.picture, replace(EXPERIMENT, camera=it), capsule_velocity=VELOCITY, background=made.background)
        for it in (None, camera)
    )
    np.testing.assert_allclose(found.lengths, plain.lengths, rtol=1e-12)
    added = 0.01 * plain.lengths
    np.testing.assert_allclose(found.covariance - plain.covariance, np.outer(added, added), rtol=0.05)


def test_a_contour_has_square_pixels_if_their_aspect_is_stated(tmp_path):
    profile = np.asarray(shapes()["profile"][40])
    path = tmp_path / "contour.csv"
    np.savetxt(path, 50.0 * profile * [1.03, 1.0] + 200.0, delimiter=",", header="x_px,y_px", comments="")
    options = {"capsule_velocity": VELOCITY, "flow": "right", "pixel_size": Quantity(0.5e-6, 2e-9, "m")}
    stated = replace(EXPERIMENT, camera=Camera(pixel_aspect="1.03 +/- 0.004"))
    found = measure_contour(ContourFile.read(path), stated, **options)
    faulty = measure_contour(ContourFile.read(path), EXPERIMENT, **options)
    assert found.axial_extent == pytest.approx(np.ptp(profile[:, 0]), rel=1e-4)
    assert faulty.axial_extent == pytest.approx(1.03 * found.axial_extent)
    assert found.outline.pose.pixel_aspect == pytest.approx(0.004)
    assert found.axial_extent_error > np.hypot(0.9 * faulty.axial_extent_error / 1.03, 0.003 * found.axial_extent)
    bent = replace(EXPERIMENT, camera=Camera(distortion=-0.01))
    with pytest.raises(InputError, match="camera: expected pixel_aspect alone for a contour"):
        measure_contour(ContourFile.read(path), bent, **options)


def test_lengths_without_their_picture_refuse_a_camera():
    stated = replace(EXPERIMENT, camera=Camera(pixel_aspect=1.02))
    lengths = np.array([100.0, 90.0, 10.0, 60.0])
    with pytest.raises(InputError, match="camera: expected none for a film"):
        measurement_of_lengths(lengths, np.eye(4), VELOCITY, stated)
