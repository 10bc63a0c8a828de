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
from capsbayes.infer import Posterior

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


def refused(*arguments):
    """Return the message of a command that is refused."""
    error = run(*arguments).exception
    assert isinstance(error, CapsbayesError)
    assert "\n" not in str(error)
    return str(error)


def test_one_capsule_end_to_end(capsule, database, tmp_path):
    size = ("--walkers", 32, "--steps", 600, "--ensembles", 5)
    result = run(capsule, "--database", database, *size, "--out", tmp_path / "result")
    assert result.exit_code == 0, result.output
    assert len(Posterior.read(tmp_path / "result" / "posterior.nc").ensemble) == 5 * 32
    printed = " ".join(result.output.split())
    for words in ("G_s [mN/m]", "a [µm]", "U [mm/s]", "68 %", "95 %", "quadrature", "published", "The engines agree"):
        assert words in printed
    for words in ("share of the variance of ln G_s", "Status: The computation succeeded (13 of 13 checks)"):
        assert words in printed
    out = tmp_path / "result"
    assert written(out) == RESULTS
    summary = json.loads((out / "summary.json").read_text())
    ca = summary["quantities"]["capillary_number"]
    assert ca["lower_68"] < 0.06 < ca["upper_68"]
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
    low, high = summary["surface_shear_modulus_over_laws"]  # one law is one of several
    assert low < summary["quantities"]["surface_shear_modulus"]["median"] < high


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
        (('axial_extent = "1', 'axial_extent = "9'), "a shape that a case of square-manufactured has (nearest: L_z/l"),
        (("channel.toml", "tunnel.toml"), "tunnel.toml: expected a file, got nothing there"),
        (('experiment = "channel.toml"\n', ""), "capsule.toml: experiment: expected the name of a file, got nothing"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing_behind(capsule, database, tmp_path, change, message):
    capsule.write_text(capsule.read_text().replace(*change))
    assert message in refused(capsule, "--database", database, "--out", tmp_path / "result")
    assert not (tmp_path / "result").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--engine", "x"), "expected emcee or quadrature"),
        (("--out", __file__), "expected a folder"),
        (("--velocity", "6.20 +/- 0.06 mm/s"), "identify: --velocity: expected a picture (.png, .tif"),
        (("--membrane", "rubber"), "--membrane: law: expected one of unknown, neo-Hookean"),
        (("--membrane", "stiffness=3"), "--membrane: expected a law, or NAME=TEXT with one of the names"),
        (("--membrane", "unknown", "--database", "square-skalak"), "expected one of the two, got both"),
        (("--engine", "quadrature", "--steps", "500"), "--engine: expected emcee with --walkers, --steps"),
        (("--steps", "500", "--most-steps", "400"), "--steps: expected at most --most-steps, 400, got 500"),
    ],
)
def test_options_that_do_not_fit_are_one_line(capsule, options, message):
    assert message in refused(capsule, *options)


def test_an_error_while_writing_leaves_nothing_behind(capsule, database, tmp_path, monkeypatch):
    from capsbayes.report import posterior_figures

    def broken(posterior, names):
        raise RuntimeError("no ink")

    monkeypatch.setattr(posterior_figures, "corner_plot", broken)
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
    assert "--experiment: expected the experiment's file with a picture" in refused(picture)
    assert "--velocity" in refused(picture, "--experiment", picture.parent / "channel.toml")


def test_what_is_known_of_the_membrane_is_stated_in_the_file_and_changed_by_options(capsule):
    table = '[membrane]\nlaw = "Skalak"\nhardening = 0.5\npre_inflation = 0.03\nbending = 2e-4\n'
    capsule.write_text(capsule.read_text() + table)
    stated = {"pre_inflation = 0.03", "bending = 0.0002"}
    of_file = json.loads(run(capsule, "--engine", "quadrature", "--json").stdout)["model"]["name"]
    assert {"strain_hardening = 1", "area_dilation_modulus = 2", *stated} == set(of_file.split(" at ")[1].split(", "))
    other = "--membrane", "neo-hookean", "--membrane", "hardening=unknown"
    changed = json.loads(run(capsule, "--engine", "quadrature", "--json", *other).stdout)["model"]["name"]
    assert {"strain_hardening = 0", "area_dilation_modulus = 3", *stated} == set(changed.split(" at ")[1].split(", "))
