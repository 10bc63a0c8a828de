"""The geometry of a camera as a calibration states it, against the map from the channel to the picture."""

import numpy as np
import pytest

from capsbayes.errors import InputError
from capsbayes.experiment import Camera, Experiment
from capsbayes.measurement import Pose
from capsbayes.profile import vertex_normals

CAMERA = Camera(pixel_aspect="1.03 +/- 0.004", distortion="-0.02 +/- 0.003", taper="0.01 +/- 0.002")
GOOD = 'cross_section = "square"\nhalf_width = "25.0 +/- 0.2 um"\nviscosity = "0.85 Pa s"\n'
ANGLE = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
EGG = np.stack([1.1 * np.cos(ANGLE) + 0.1 * np.cos(2.0 * ANGLE), 0.8 * np.sin(ANGLE)], axis=1)


def pictured(points, aspect, distortion, taper, walls):
    """Perspective, then the lens, then pixels; all over l as it is read at the walls."""
    points = points / (1.0 - taper * points[:, :1])
    points = points * (1.0 + distortion * np.sum(points**2, axis=1, keepdims=True)) / (1.0 + distortion * walls)
    return points * [aspect, 1.0]


def test_what_is_seen_is_straightened():
    points = EGG + np.array([0.7, 0.0])
    seen = pictured(points, 1.03, -0.02, 0.01, walls=2.2)
    assert np.abs(seen - points).max() > 0.03
    np.testing.assert_allclose(CAMERA.straightened(seen, walls=2.2), points, atol=1e-6)
    np.testing.assert_array_equal(Camera().straightened(seen, walls=2.2), seen)


def test_errors_are_those_of_each_number():
    errors = CAMERA.errors_of(EGG, walls=1.5)
    means, sds = np.array([1.03, -0.02, 0.01]), np.array([0.004, 0.003, 0.002])
    for number, error in enumerate(errors):
        off = pictured(CAMERA.straightened(EGG, walls=1.5), *(means + sds * (np.arange(3) == number)), walls=1.5)
        np.testing.assert_allclose(EGG - off, error, atol=0.08 * np.abs(error).max())


def test_the_pose_of_an_outline_has_the_directions_of_the_camera():
    """The change of the normal distances by a standard error of each number, by differences of the map."""
    shifted = EGG + np.array([0.6, 0.0])
    normal = vertex_normals(EGG)
    middle = 0.5 * (shifted[:, 0].max() + shifted[:, 0].min())
    pose = Pose(pixel_aspect=0.004, distortion=0.003, taper=0.002, middle=middle, walls=1.8)
    changes = pose.directions(EGG, normal)
    assert changes.shape == (len(EGG), 7)
    sds = np.diag([0.004, 0.003, 0.002])
    for sd, change in zip(sds, changes.T[4:], strict=True):
        moved = pictured(shifted, 1.0 + sd[0], *sd[1:], walls=1.8) - shifted
        left = np.sum(moved * normal, axis=1) - change
        left -= normal[:, 0] * (left @ normal[:, 0]) / np.sum(normal[:, 0] ** 2)  # a shift along the flow
        assert np.abs(left).max() < 0.02 * np.abs(change).max()
    np.testing.assert_array_equal(Pose().directions(EGG, normal), changes[:, :4])


def test_an_experiment_states_its_camera(tmp_path):
    path = tmp_path / "experiment.toml"
    path.write_text(GOOD + '[camera]\npixel_aspect = "1.02 +/- 0.005"\ntaper = "0 +/- 0.002"\n')
    camera = Experiment.read(path).camera
    assert camera == Camera(pixel_aspect="1.02 +/- 0.005", taper="0 +/- 0.002")
    assert list(camera.stated) == ["pixel_aspect", "taper"]
    assert Experiment.read(path).described()["camera"] == "pixel_aspect 1.02 +/- 0.005, taper 0.0 +/- 0.002"
    Experiment.read(path).write(tmp_path / "again.toml")
    assert Experiment.read(tmp_path / "again.toml").camera == camera
    assert Experiment(cross_section="square", half_width=25e-6, viscosity=0.85).camera is None


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('pixel_aspect = "2 %"', r'camera.pixel_aspect: expected a text without unit like "1.020 \+/- 0.005"'),
        ('pixel_aspect = "0.02"', r"camera.pixel_aspect: expected a number within 0.1 of 1 with its error"),
        ("distortion = -0.01", r'camera.distortion: expected a text like "-0.010 \+/- 0.002", got -0.01'),
        ('distortion = "-0.05 +/- 0.06"', r"camera.distortion: expected a number within 0.1 of 0 with its error"),
        ('tilt = "2 deg"', r"camera.tilt: expected one of pixel_aspect, distortion, taper, got an unknown key"),
    ],
)
def test_what_cannot_be_used_is_refused(tmp_path, line, message):
    path = tmp_path / "experiment.toml"
    path.write_text(f"{GOOD}[camera]\n{line}\n")
    with pytest.raises(InputError, match=message):
        Experiment.read(path)
