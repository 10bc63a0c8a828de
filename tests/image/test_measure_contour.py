import cv2
import numpy as np
import pytest
from drawn import circle, shapes

from capsbayes.errors import InputError
from capsbayes.experiment import Experiment
from capsbayes.image.files.contour import ContourFile
from capsbayes.image.measure_contour import measure_contour
from capsbayes.profile import Profile
from capsbayes.quantity import Quantity

EXPERIMENT = Experiment(cross_section="square", half_width=25e-6, viscosity=0.85)
PIXEL = Quantity(0.5e-6, 0.002e-6, "m")


def measured(path, unit=None, **options):
    given = {"edge_error": Quantity(0.05e-6, 0.0, "m"), "flow": "right", "pixel_size": PIXEL} | options
    speed = Quantity(6e-3, 6e-5, "m/s")
    return measure_contour(ContourFile.read(path, unit), EXPERIMENT, capsule_velocity=speed, **given)


def written(path, points, header="x_px,y_px"):
    np.savetxt(path, points, fmt="%.6g", delimiter=",", header=header, comments="")
    return path


def parachute():
    cases = shapes()
    profile = cases["profile"][int(np.argmax(cases["axial_extent"] - cases["axial_length"]))]
    outline = Profile.from_outline(profile)
    return profile, outline.axial_extent, outline.axial_length


@pytest.mark.parametrize(("header", "scale"), [("x_px,y_px", 50.0), ("x_um,y_um", 25.0), ("y_um,label,x_um", 25.0)])
@pytest.mark.parametrize("flow", ["right", "left"])
def test_a_traced_parachute_has_both_lengths(tmp_path, header, scale, flow):
    profile, extent, length = parachute()
    points = scale * np.asarray(profile) * [1.0 if flow == "right" else -1.0, 1.0] + [200.3, 80.7]
    if "label" in header:
        points = np.column_stack([points[:, 1], np.zeros(len(points)), points[:, 0]])
    found = measured(written(tmp_path / "c.csv", points, header), flow=flow)
    assert not found.over_half_width
    np.testing.assert_allclose(found.lengths, [25e-6 * extent, 25e-6 * length], atol=1e-9)
    pixel = 0.0 if "um" in header else 0.002 / 0.5 * 25e-6 * extent
    assert found.axial_extent_error == pytest.approx(np.hypot(np.sqrt(2.0) * 0.05e-6, pixel), rel=1e-3)


def test_the_text_file_of_imagej_needs_its_unit(tmp_path):
    path = tmp_path / "points.txt"
    np.savetxt(path, 20.0 * circle(1.0), delimiter="\t", fmt="%.3f")
    assert measured(path, "um").axial_extent == pytest.approx(40e-6, rel=2e-3)
    with pytest.raises(InputError, match="or the unit px or um"):
        measured(path)


def test_a_polygon_through_pixel_centres_is_not_taken_for_the_edge(tmp_path):
    """It understates the radius by some 0.45 px; without being told, a contour of whole pixels is refused."""
    errors = []
    for radius in 18.3 + 1.03 * np.arange(12):
        yy, xx = np.mgrid[:80, :80]
        mask = (np.hypot(xx - 39.7, yy - 40.2) < radius).astype(np.uint8)
        contour = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0][0][:, 0]
        path = written(tmp_path / "mask.csv", contour)
        found = measured(path, points="centres", edge_error=Quantity(0.2e-6, 0.0, "m"))
        errors.append(found.axial_extent / 0.5e-6 - 2.0 * radius)
        assert abs(errors[-1]) < 2.5 * found.axial_extent_error / 0.5e-6
        assert found.axial_length is None
        assert found.axial_length_bound > found.axial_extent
    assert abs(np.mean(errors)) < 0.3
    with pytest.raises(InputError, match="say centres or borders"):
        measured(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "an empty file"),
        ("length,width\n1,2\n", "columns: expected x_px, y_px or x_um, y_um, got length, width"),
        ("x_um,y_um\n1,2\n3,4\n", "points: expected at least 16 finite points, got 2 points"),
        ("x_um,y_um\n1,2\n3,\n", "points: expected two numbers in each line"),
    ],
)
def test_a_file_without_points_is_refused_in_one_line(tmp_path, content, message):
    path = tmp_path / "c.csv"
    path.write_text(content)
    with pytest.raises(InputError, match=message) as caught:
        ContourFile.read(path)
    assert "\n" not in str(caught.value)


def test_points_in_pixels_need_the_size_of_a_pixel(tmp_path):
    with pytest.raises(InputError, match="pixel size: expected one with an error"):
        measured(written(tmp_path / "c.csv", 20.0 * circle(1.0)), pixel_size=None)
