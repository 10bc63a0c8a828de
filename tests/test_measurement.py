"""A measurement and its outline as files and calls state them, and what all outlines of a microscope share."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from capsbayes.errors import InputError
from capsbayes.measurement import MeasuredOutline, Measurement, OutlineNoise, Pose
from capsbayes.profile import vertex_normals
from capsbayes.quantity import Quantity
from capsbayes.status import Status

GOOD = """experiment = "experiment.toml"
[measurement]
axial_extent = "2.14 +/- 0.02"
axial_length = "1.81 +/- 0.01"
length_correlation = 0.5
capsule_velocity = "6.20 +/- 0.06 mm/s"
"""


def written(tmp_path, text):
    path = tmp_path / "capsule.toml"
    path.write_text(text)
    return path


def made(**changes):
    good = {
        "axial_extent": 2.14,
        "axial_extent_error": 0.02,
        "axial_length": 1.81,
        "axial_length_error": 0.01,
        "capsule_velocity": 6e-3,
        "capsule_velocity_error": 6e-5,
    }
    return Measurement(**(good | changes))


def test_lengths_over_l(tmp_path):
    seen = Measurement.read(written(tmp_path, GOOD))
    assert seen.over_half_width
    np.testing.assert_allclose(seen.lengths, [2.14, 1.81])
    np.testing.assert_allclose(seen.covariance, [[4e-4, 1e-4], [1e-4, 1e-4]])
    assert seen.capsule_velocity == pytest.approx(6.2e-3)
    assert seen.capsule_velocity_error == pytest.approx(6e-5)
    assert seen.experiment_file == tmp_path / "experiment.toml"
    assert len(seen.sha256) == 64
    assert seen.status.ok


def test_lengths_in_metres(tmp_path):
    text = GOOD.replace("2.14 +/- 0.02", "53.5 +/- 0.5 um").replace("1.81 +/- 0.01", "0.04525 +/- 0.00025 mm")
    seen = Measurement.read(written(tmp_path, text))
    assert not seen.over_half_width
    np.testing.assert_allclose(seen.lengths, [53.5e-6, 45.25e-6])


def test_the_length_on_the_axis_may_be_missing(tmp_path):
    text = "\n".join(line for line in GOOD.splitlines() if not line.startswith(("axial_length", "length_corr")))
    seen = Measurement.read(written(tmp_path, text))
    assert seen.axial_length is None
    np.testing.assert_allclose(seen.covariance, [[4e-4]])
    assert seen.lengths.shape == (1,)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("1.81", "2.15"), "axial_length: expected at most the axial extent 2.14, got 2.15"),
        (("2.14 +/- 0.02", "2.14"), 'measurement.axial_extent: expected a standard error, as in "2.14 +/- 0.01"'),
        (("2.14 +/- 0.02", "2.14 +/- 0.02 Pa"), "measurement.axial_extent: expected a text without unit or in m"),
        (("1.81 +/- 0.01", "45 +/- 1 um"), "measurement.axial_length: expected a text without unit like"),
        (("mm/s", "mm"), "measurement.capsule_velocity: expected a text in m/s"),
        (("6.20", "-6.20"), "measurement.capsule_velocity: expected a positive finite number"),
        (("2.14", "nan"), "measurement.axial_extent: expected a positive finite number"),
        (("axial_extent", "axial_extend"), "measurement.axial_extend: expected one of axial_extent, capsule_velocity"),
        (("length_correlation = 0.5", "length_correlation = 1.0"), "length_correlation: expected a number between -1"),
        (("length_correlation = 0.5", 'length_correlation = "a"'), "length_correlation: expected a number between -1"),
        (
            ("[measurement]", "[seen]"),
            "seen: expected one of measurement, experiment, prior, membrane, outline, got an unknown key",
        ),
        (
            ("[measurement]", '[measurement]\nflow_rate = "3 mm/s"'),
            "measurement.flow_rate: expected a text in m^3/s like",
        ),
        (('experiment = "experiment.toml"', "experiment = 3"), "experiment: expected the name of a file"),
        (("axial_extent", "#"), "measurement.axial_extent: expected a value, got nothing; add the missing key"),
    ],
)
def test_mistakes_name_file_key_expected_and_got(tmp_path, change, message):
    with pytest.raises(InputError) as caught:
        Measurement.read(written(tmp_path, GOOD.replace(*change)))
    assert f"capsule.toml: {message}" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "changes",
    [
        {"axial_extent": np.nan},
        {"axial_extent": -1.0},
        {"axial_extent_error": 0.0},
        {"axial_length_error": None},
        {"axial_length": None},
        {"capsule_velocity": np.inf},
        {"capsule_velocity_error": -1e-5},
        {"length_correlation": np.nan},
        {"axial_length": 2.2},
        {"flow_rate": -1e-11},
        {"flow_rate": "0.5 .. 0.9 uL/min"},
        {"axial_length": None, "axial_length_error": None, "axial_length_bound": True},
        {"axial_extent": True},
        {"length_correlation": True},
        {"status": "DONE"},
        {"outline": "x.csv"},
        {"conditions": ["half_width"]},
        {"conditions": {"half_width": 25.0}},
        {"conditions": {"width": 25e-6}},
    ],
)
def test_values_that_cannot_be_are_refused(changes):
    with pytest.raises(InputError, match="measurement: "):
        made(**changes)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"flow_rate": 1e-11},
        {"over_half_width": False, "axial_extent": 5e-5, "axial_extent_error": 1e-7, "axial_length": 4e-5}
        | {"axial_length_error": 1e-7},
        {"axial_length": None, "axial_length_error": None, "axial_length_bound": 2.2},
    ],
)
def test_what_is_written_is_read_again(tmp_path, changes):
    seen = made(length_correlation=0.25 if "axial_length_bound" not in changes else 0.0, **changes)
    seen.write(tmp_path / "capsule.toml")
    again = Measurement.read(tmp_path / "capsule.toml")
    np.testing.assert_allclose(again.lengths, seen.lengths, rtol=1e-12)
    np.testing.assert_allclose(again.covariance, seen.covariance, rtol=1e-12)
    assert again.capsule_velocity == pytest.approx(seen.capsule_velocity, rel=1e-12)
    assert again.axial_length_bound == seen.axial_length_bound
    assert (again.over_half_width, again.flow_rate) == (seen.over_half_width, seen.flow_rate)


def test_a_refused_measurement_has_a_status_and_no_numbers(tmp_path):
    refused = Measurement.refused(Status.NO_CAPSULE, source="capsule.png")
    assert refused.status is Status.NO_CAPSULE
    assert np.isnan(refused.axial_extent)
    with pytest.raises(InputError, match="No capsule was found"):
        refused.write(tmp_path / "capsule.toml")
    assert not (tmp_path / "capsule.toml").exists()


def with_outline():
    angle = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
    points = np.stack([1.07 * np.cos(angle), 0.9 * np.sin(angle)], axis=1)
    return made(outline=MeasuredOutline(points, OutlineNoise(0.004, 0.15, white=0.25)))


def test_an_outline_is_written_next_to_it_and_read_again(tmp_path):
    seen = with_outline()
    seen.write(tmp_path / "capsule.toml")
    again = Measurement.read(tmp_path / "capsule.toml").outline
    np.testing.assert_allclose(again.points, seen.outline.points, rtol=1e-8, atol=1e-9)
    assert again.noise == seen.outline.noise
    assert (tmp_path / "capsule.outline.csv").read_text().startswith("z_over_l,y_over_l\n")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("noise = 0.004", 'noise = "small"'), "outline.noise: expected a number from 0 to 1000, got 'small'"),
        (("noise = 0.004", "noise = 0.0"), "scale: expected a positive number"),
        (("noise = 0.004\n", ""), "outline.noise: expected a value, got nothing"),
        (("capsule.outline.csv", "other.csv"), "other.csv: expected a file of points, got nothing there"),
        (("capsule.outline.csv", "capsule.toml"), "z_over_l: expected a column of that name"),
    ],
)
def test_mistakes_in_an_outline_are_named(tmp_path, change, message):
    path = tmp_path / "capsule.toml"
    with_outline().write(path)
    path.write_text(path.read_text().replace(*change))
    with pytest.raises(InputError) as caught:
        Measurement.read(path)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_says_what_its_outline_shows(tmp_path):
    seen = with_outline()
    path = tmp_path / "capsule.toml"
    seen.write(path)
    assert "view" not in path.read_text()
    replace(seen, outline=replace(seen.outline, view="silhouette")).write(path)
    assert Measurement.read(path).outline.view == "silhouette"
    path.write_text(path.read_text().replace('"silhouette"', '"section"'))  # the word of older files
    assert Measurement.read(path).outline.view == "mid-plane"
    path.write_text(path.read_text().replace('"section"', '"shadow"'))
    with pytest.raises(InputError, match=r'outline\.view: expected "mid-plane" or "silhouette", got \'shadow\''):
        Measurement.read(path)


@pytest.mark.parametrize(
    "given",
    [
        {"axial_extent": "2.14 +/- 0.02", "axial_length": "1.81 +/- 0.01", "capsule_velocity": "6.0 +/- 0.06 mm/s"},
        {"axial_extent": Quantity(2.14, 0.02), "axial_length": Quantity(1.81, 0.01), "capsule_velocity": stats.norm(6e-3, 6e-5)},  # noqa: E501
        {"axial_extent": "53.5 +/- 0.5 um", "axial_length": "45.25 +/- 0.25 um", "capsule_velocity": "6.00(6) mm/s"},
    ],
)  # fmt: skip
def test_numbers_are_given_in_any_form(given):
    seen = Measurement(**given, flow_rate="0.6 uL/min")
    assert seen.over_half_width == ("um" not in str(given))
    scale = 1.0 if seen.over_half_width else 25e-6
    np.testing.assert_allclose(seen.lengths, scale * np.array([2.14, 1.81]))
    np.testing.assert_allclose(np.sqrt(np.diag(seen.covariance)), scale * np.array([0.02, 0.01]))
    assert (seen.capsule_velocity, seen.capsule_velocity_error) == pytest.approx((6e-3, 6e-5))
    assert seen.flow_rate == pytest.approx(1e-11)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"axial_extent": 53.5}, 'axial_extent: expected a value from 0.01 to 20 l, got 53.5 l (read in l); did you mean "53.5 um"?'),  # noqa: E501
        ({"capsule_velocity": 6}, 'got 6 m/s (read in m/s); did you mean "6 mm/s"?'),
        ({"capsule_velocity": "6 mm/s"}, 'capsule_velocity: expected a standard error, as in "5.00 +/- 0.05 mm/s"'),
        ({"axial_length": "45 +/- 1 um"}, "axial_length: expected a text without unit"),
        ({"axial_length_bound": "long"}, "axial_length_bound: expected a positive finite number, got 'long'"),
        ({"axial_length_bound": 2.2}, "axial_length_bound: expected none next to axial_length, got 2"),
        ({"capsule_velocity": None}, "capsule_velocity: expected a positive finite number, got None"),
        ({"flow_rate": 0.6}, 'flow_rate: expected a value from 1e-18 to 0.001 m^3/s, got 0.6 m^3/s (read in m^3/s); did you mean "0.6 uL/min"?'),  # noqa: E501
    ],
)  # fmt: skip
def test_a_number_that_no_experiment_has_names_the_unit_it_was_read_in(changes, message):
    with pytest.raises(InputError) as caught:
        made(**changes)
    assert message in str(caught.value)


def test_a_velocity_may_be_missing_until_it_is_needed(tmp_path):
    seen = Measurement.read(written(tmp_path, GOOD.replace('capsule_velocity = "6.20 +/- 0.06 mm/s"', "")))
    assert "capsule_velocity" not in seen.described()
    seen.write(tmp_path / "again.toml")
    again = Measurement.read(tmp_path / "again.toml")
    assert again.capsule_velocity is None
    with pytest.raises(InputError, match=r"measurement\.capsule_velocity: expected a value with an error, got nothing"):
        _ = again.known_velocity


ANGLE = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
POINTS = np.stack([1.1 * np.cos(ANGLE), 0.8 * np.sin(ANGLE)], axis=1)
NORMAL = vertex_normals(POINTS)


def covariance(outline):
    """Covariance of the normal distances: noise and microscope, place and tilt left out."""
    posed = outline.pose.directions(POINTS, NORMAL)[:, 3:]
    return outline.noise.covariance(POINTS) + posed @ posed.T


@pytest.mark.parametrize("correlation", [0.0, 0.3])
def test_what_capsules_share_counts_as_often_as_there_are_capsules(correlation):
    pose = Pose(offset=0.002, pixel_aspect=0.01, rear=0.004)
    outline = MeasuredOutline(POINTS, OutlineNoise(0.003, correlation, 0.5 if correlation else 0.0), pose)
    shared = outline.shared(POINTS, NORMAL)
    wider = outline.shared_by(9)
    arcs = shared[2:]  # after the offset and the aspect of the pixels
    both = covariance(outline) + 8.0 * shared.T @ shared
    assert covariance(wider) == pytest.approx(both, abs=1e-10)
    assert len(arcs) == (len(POINTS) if correlation else 0)
    assert wider.pose.rear == pytest.approx(3.0 * 0.004)
    assert np.array_equal(wider.points, outline.points)


def test_one_capsule_keeps_its_errors():
    outline = MeasuredOutline(POINTS, OutlineNoise(0.003, 0.3, 0.5), Pose(offset=0.002))
    assert outline.shared_by(1).noise == outline.noise
    assert outline.shared_by(1).pose == outline.pose


@pytest.mark.parametrize("numbers", [(np.inf, 0.2, 0.0), (0.01, np.inf, 0.0), (0.01, 1e300, 0.0), (0.01, 0.2, np.nan)])
def test_an_error_beyond_all_lengths_of_a_capsule_is_refused(numbers):
    with pytest.raises(InputError, match=r"OutlineNoise: .*: expected a (positive )?number up to 1"):
        OutlineNoise(*numbers)
