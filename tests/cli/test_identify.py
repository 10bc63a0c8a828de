import json
from pathlib import Path

import cv2
import manufactured
import pytest
from command_line import written
from drawn import drawn
from typer.testing import CliRunner

from capsbayes.cli import app
from capsbayes.errors import CapsbayesError

EXPERIMENT = 'cross_section = "square"\nhalf_width = "25.0 +/- 0.2 um"\nviscosity = "0.85 +/- 0.02 Pa s"\n'
EXAMPLE = Path(__file__).parents[2] / "examples" / "ovalbumin" / "capsule.toml"
RESULTS = {"posterior.nc", "summary.json", "corner.png", "outline.png"}


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    return manufactured.database_file(tmp_path_factory.mktemp("database"))


@pytest.fixture
def capsule(tmp_path):
    return manufactured.capsule_file(tmp_path, EXPERIMENT)


def run(*arguments):
    return CliRunner().invoke(app, ["identify", *map(str, arguments)])


def test_one_capsule_end_to_end(capsule, database, tmp_path):
    result = run(capsule, "--database", database, "--out", tmp_path / "result")
    assert result.exit_code == 0, result.output
    for words in (
        "G_s [mN/m]",
        "a [µm]",
        "U [mm/s]",
        "68 %",
        "95 %",
        "quadrature",
        "published",
        "The engines agree",
    ):
        assert words in " ".join(result.output.split())
    assert "share of the variance of ln G_s" in result.output
    printed = " ".join(result.output.split())
    assert "Status: The computation succeeded (13 of 13 checks). The interval is valid if the membrane" in printed
    out = tmp_path / "result"
    assert written(out) == RESULTS
    summary = json.loads((out / "summary.json").read_text())
    assert (
        summary["quantities"]["capillary_number"]["lower_68"]
        < 0.06
        < summary["quantities"]["capillary_number"]["upper_68"]
    )
    assert summary["deterministic"]["size_ratio"] == pytest.approx(0.9, abs=0.01)
    assert set(summary["inputs"]["files"]) == {"capsule.toml", "channel.toml"}
    for name in ("corner.png", "outline.png"):
        assert (out / name).read_bytes().startswith(b"\x89PNG")


def test_the_papers_capsule_with_the_database_that_comes_with_the_library():
    """The paper: Ca = 0.082, a/l = 0.96, v_o/U = 1.29 from L_z = 2.14 l and L_a = 1.81 l."""
    result = run(EXAMPLE, "--engine", "quadrature", "--json")
    assert result.exit_code == 0, result.output
    summary = json.loads(result.stdout)
    for name, value in (("capillary_number", 0.082), ("size_ratio", 0.96), ("velocity_ratio", 1.29)):
        found = summary["quantities"][name]
        assert found["lower_68"] < value < found["upper_68"], name
        assert summary["deterministic"][name] == pytest.approx(value, rel=0.05), name
    assert sum(summary["variance_of_log_surface_shear_modulus"].values()) == pytest.approx(1.0)


def test_json_is_all_that_is_printed(capsule, database):
    result = run(capsule, "--database", database, "--engine", "quadrature", "--seed", "7", "--json")
    assert result.exit_code == 0
    summary = json.loads(result.stdout)
    assert (summary["engine"], summary["seed"], summary["status"]) == ("quadrature", 7, "DONE")
    assert summary["agreement"] is None


def test_a_posterior_on_the_border_ends_with_status_one(capsule, database):
    text = capsule.read_text()
    capsule.write_text("\n".join(line for line in text.splitlines() if not line.startswith("axial_length")))
    result = run(capsule, "--database", database, "--engine", "quadrature")
    assert result.exit_code == 1
    assert "leans on the border" in " ".join(result.output.split())
    assert "next to the border of the database" in " ".join(result.output.split())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("axial_extent", "axial_extend"), "capsule.toml: measurement.axial_extend: expected one of axial_extent"),
        (("mm/s", "mm"), "capsule.toml: measurement.capsule_velocity: expected a text in m/s"),
        (("6.20", "nan"), "capsule.toml: measurement.capsule_velocity: expected a positive finite number"),
        (('axial_extent = "1', 'axial_extent = "9'), "a shape that a case of square-manufactured has (nearest: L_z/l"),
        (('axial_length = "1', 'axial_length = "9'), "capsule.toml: axial_length: expected at most the axial extent"),
        (("channel.toml", "tunnel.toml"), "tunnel.toml: expected a file, got nothing there"),
        (('experiment = "channel.toml"\n', ""), "capsule.toml: experiment: expected the name of a file, got nothing"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing_behind(capsule, database, tmp_path, change, message):
    capsule.write_text(capsule.read_text().replace(*change))
    result = run(capsule, "--database", database, "--out", tmp_path / "result")
    assert isinstance(result.exception, CapsbayesError)
    assert message in str(result.exception)
    assert "\n" not in str(result.exception)
    assert not (tmp_path / "result").exists()


def test_an_unknown_engine_or_a_file_in_the_way_is_said(capsule, database, tmp_path):
    assert "expected emcee or quadrature" in str(run(capsule, "--database", database, "--engine", "x").exception)
    (tmp_path / "file").write_text("")
    assert "expected a folder" in str(run(capsule, "--database", database, "--out", tmp_path / "file").exception)


def test_an_error_while_writing_leaves_nothing_behind(capsule, database, tmp_path, monkeypatch):
    import capsbayes.report

    def broken(posterior, names):
        raise RuntimeError("no ink")

    monkeypatch.setattr(capsbayes.report, "corner_plot", broken)
    result = run(capsule, "--database", database, "--engine", "quadrature", "--out", tmp_path / "result")
    assert str(result.exception) == "no ink"
    assert not (tmp_path / "result").exists()


@pytest.fixture
def picture(tmp_path):
    """A drawn capsule at Ca = 0.08, a/l = 1.05, whose rear is seen."""
    made = drawn(0.08, 1.05, half_width=55.0)
    cv2.imwrite(str(tmp_path / "capsule.png"), made.picture)
    cv2.imwrite(str(tmp_path / "empty.png"), made.background)
    (tmp_path / "channel.toml").write_text(EXPERIMENT)
    return tmp_path / "capsule.png"


@pytest.mark.slow
def test_a_picture_is_measured_and_identified_in_one_go(picture):
    out = picture.parent / "result"
    options = ("--experiment", picture.parent / "channel.toml", "--velocity", "6.20 +/- 0.06 mm/s")
    result = run(
        picture, *options, "--background", picture.parent / "empty.png", "--engine", "quadrature", "--out", out
    )
    assert result.exit_code == 0, result.output
    measured = {"measurement.toml", "measurement.outline.csv", "outline.csv", "silhouette.csv", "overlay.png"}
    assert written(out) == RESULTS | measured
    summary = json.loads((out / "summary.json").read_text())
    ca = summary["quantities"]["capillary_number"]
    assert ca["lower_95"] < 0.08 < ca["upper_95"]
    assert summary["quantities"]["size_ratio"]["sd"] < 0.003
    assert {"outline", "axial_length"} < set(summary["variance_of_log_surface_shear_modulus"])
    assert "(silhouettes)" in result.output
    again = run(out / "measurement.toml", "--engine", "quadrature", "--json")
    assert json.loads(again.stdout)["quantities"]["size_ratio"] == pytest.approx(summary["quantities"]["size_ratio"])


def test_a_picture_needs_an_experiment_and_a_velocity(picture):
    assert "--experiment: expected the experiment's file with a picture" in str(run(picture).exception)
    lacking = run(picture, "--experiment", picture.parent / "channel.toml")
    assert "--velocity" in str(lacking.exception)


def test_what_belongs_to_a_picture_is_refused_with_a_measurement(capsule):
    result = run(capsule, "--velocity", "6.20 +/- 0.06 mm/s")
    assert "identify: --velocity: expected a picture (.png, .tif" in str(result.exception)


def test_what_is_known_of_the_membrane_is_stated_in_the_file_and_changed_by_options(capsule):
    table = '[membrane]\nlaw = "Skalak"\nhardening = 0.5\npre_inflation = 0.03\nbending = 2e-4\n'
    capsule.write_text(capsule.read_text() + table)
    stated = {"pre_inflation = 0.03", "bending = 0.0002"}
    of_file = json.loads(run(capsule, "--engine", "quadrature", "--json").stdout)["model"]["name"]
    assert {"strain_hardening = 1", "area_dilation_modulus = 2", *stated} == set(of_file.split(" at ")[1].split(", "))
    other = "--membrane", "neo-hookean", "--membrane", "hardening=unknown"
    changed = json.loads(run(capsule, "--engine", "quadrature", "--json", *other).stdout)["model"]["name"]
    assert {"strain_hardening = 0", "area_dilation_modulus = 3", *stated} == set(changed.split(" at ")[1].split(", "))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--membrane", "rubber"), "--membrane: law: expected one of unknown, neo-Hookean"),
        (("--membrane", "stiffness=3"), "--membrane: expected a law, or NAME=TEXT with one of the names"),
        (("--membrane", "unknown", "--database", "square-skalak"), "expected one of the two, got both"),
    ],
)
def test_mistakes_about_the_membrane_are_one_line(capsule, options, message):
    result = run(capsule, *options)
    assert isinstance(result.exception, CapsbayesError)
    assert message in str(result.exception)


def test_one_law_is_said_to_be_one_of_several(capsule):
    plain = json.loads(run(capsule, "--engine", "quadrature", "--json").stdout)
    low, high = plain["surface_shear_modulus_over_laws"]
    assert low < plain["quantities"]["surface_shear_modulus"]["median"] < high
