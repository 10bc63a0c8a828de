import json

import manufactured
import numpy as np
import pytest
import xarray as xr
from command_line import written
from typer.testing import CliRunner

from capsbayes.cli import app
from capsbayes.errors import CapsbayesError

EXPERIMENT = 'section = "square"\nhalf_width = "25.0 um"\nviscosity = "0.85 Pa s"\n'
LAB = ("--extent-error", "0.01", "--length-error", "0.01", "--velocity-error", "0.01")


@pytest.fixture(scope="module")
def database(tmp_path_factory):
    return manufactured.database_file(tmp_path_factory.mktemp("database"))


@pytest.fixture
def capsule(tmp_path):
    return manufactured.capsule_file(tmp_path, EXPERIMENT)


def run(*arguments):
    return CliRunner().invoke(app, ["sensitivity", *map(str, arguments)])


def said(result):
    return " ".join(result.output.split())


def test_the_budget_of_a_capsule(capsule, database, tmp_path):
    result = run("budget", capsule, "--database", database, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    for words in ("Error budget: G_s =", "mu = 0.85 Pa s", "L_a =", "model's own error", "seed 1", "Status: Done."):
        assert words in said(result)
    assert written(tmp_path / "out") == {"budget.json", "budget.csv", "budget.png"}
    stored = json.loads((tmp_path / "out" / "budget.json").read_text())
    shares = [row["share_of_variance"]["surface_shear_modulus"] for row in stored["inputs"].values()]
    assert sum(shares) == pytest.approx(1.0)


def test_the_budget_of_a_capsule_of_unknown_membrane(capsule):
    result = run("budget", capsule, "--membrane", "Blatz-Ko", "--membrane", "bending=1e-4", "--json")
    stored = json.loads(result.stdout)
    for name in ("pre_inflation", "area_dilation_modulus"):
        assert stored["inputs"][name]["share_of_variance"]["surface_shear_modulus"] > 0.0
    assert "strain_hardening" not in stored["inputs"]


def test_a_budget_that_leans_on_the_border_ends_with_status_one(capsule, database):
    capsule.write_text("\n".join(line for line in capsule.read_text().splitlines() if "axial_length" not in line))
    result = run("budget", capsule, "--database", database, "--json")
    assert result.exit_code == 1
    stored = json.loads(result.stdout)
    assert stored["status"] == "LEANS_ON_BORDER"
    assert "L_a was not measured" in stored["notes"][0]


def test_sobol_indices_of_a_capsule(capsule, database, tmp_path):
    asked = ("sobol", capsule, "--database", database, "--samples", 64, "--range", "viscosity=0.8 .. 0.9 Pa s")
    result = run(*asked, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    for words in ("mu = 0.8 .. 0.9 Pa s", "L_z =", "384 samples in 64 groups", "Status: Done."):
        assert words in said(result)
    assert written(tmp_path / "out") == {"sobol.json", "sobol.png"}
    stored = json.loads(run(*asked, "--json").stdout)
    assert stored == json.loads((tmp_path / "out" / "sobol.json").read_text())
    assert stored["indices"]["capillary_number"]["viscosity"]["total"] == 0.0


def test_the_map_of_a_lab(capsule, database, tmp_path):
    asked = ("map", "--like", capsule, "--database", database, "--points", 6, 5, "--noises", 3)
    result = run(*asked, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "half of the 68 % interval over the median" in said(result)
    assert written(tmp_path / "out") == {"map.nc", "map.json", "map.png", "map-radius.png"}
    with xr.open_dataset(tmp_path / "out" / "map.nc", engine="h5netcdf") as found:
        assert dict(found.sizes) == {"size_ratio": 5, "capillary_number": 6}
        smallest = float(found["width_of_surface_shear_modulus"].min())
        assert len(found.attrs["model_sha256"]) == 64
    stored = json.loads((tmp_path / "out" / "map.json").read_text())
    assert stored["best"]["width_of_surface_shear_modulus"] >= smallest


def test_the_map_of_an_unknown_membrane(capsule, tmp_path):
    known = ("--membrane", "Blatz-Ko", "--membrane", "bending=1e-4", "--guess", "area_dilation_modulus=3")
    result = run("map", "--like", capsule, *known, "--points", 3, 2, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    for words in ("of ln G_s of one capsule", "lengths unknown", "lengths known", "alpha = 0.05, K = 3, h = 0"):
        assert words in said(result)
    assert written(tmp_path / "out") == {"map.nc", "map.json", "map.png"}
    stored = json.loads((tmp_path / "out" / "map.json").read_text())
    assert stored["quantiles"]["unknown_lengths"]["median"] > stored["quantiles"]["known_lengths"]["median"]


def test_the_flow_rate_for_expected_capsules(capsule, database, tmp_path):
    expected = ("--shear-modulus", "50 +/- 2 mN/m", "--radius", "22.5 um", "--database", database)
    result = run("flow", *expected, "--like", capsule, "--out", tmp_path / "out", "--simulate", 10)
    assert result.exit_code == 0, result.output
    for words in ("Best: U =", "µL/min", "10 simulated capsules came out at", "at most 5% was asked for"):
        assert words in said(result)
    assert written(tmp_path / "out") == {"flow.json", "flow.csv", "flow.png"}
    stored = json.loads((tmp_path / "out" / "flow.json").read_text())
    best = stored["best"]
    assert best["flow_rate"] == pytest.approx(best["mean_velocity"] * 50e-6**2)
    assert best["mean_velocity"] < stored["limit"]["mean_velocity"]
    rows = np.genfromtxt(tmp_path / "out" / "flow.csv", delimiter=",", names=True)
    assert len(rows) == len(stored["points"])


FLOW = ("flow", "--like", "CAPSULE")
BATCH = ("flow", "--shear-modulus", "50 +/- 2 mN/m", "--radius", "22.5 +/- 0.5 um", "--like", "CAPSULE")
KNOWN = ("--membrane", "neo-Hookean", "--membrane", "bending=1e-4", "--guess", "pre_inflation=0.03")


def test_flow_rates_for_a_batch_of_unknown_membrane(capsule, tmp_path):
    asked = [capsule if word == "CAPSULE" else word for word in (*BATCH, *KNOWN)]
    speeds = ("--mean-velocity", "2 mm/s", "--mean-velocity", "4 mm/s", "--capsules", 6)
    result = run(*asked, *speeds, "--out", tmp_path / "out")
    assert result.exit_code == 0, result.output
    for words in (
        "6 capsules, filmed in equal shares",
        "Film at U = 2, 4 mm/s",
        "tell alpha",
        "alpha = 0.03",
        "Slower",
    ):
        assert words in said(result)
    assert written(tmp_path / "out") == {"flow.json", "flow.csv", "flow.png"}
    stored = json.loads((tmp_path / "out" / "flow.json").read_text())
    assert stored["sets"][0]["mean_velocities"] == [2e-3, 4e-3]
    rows = np.genfromtxt(tmp_path / "out" / "flow.csv", delimiter=",", names=True)
    assert len(rows) == len(stored["velocities"])


def test_what_a_file_states_of_the_membrane_is_read(capsule):
    text = capsule.read_text() + '[membrane]\nlaw = "neo-Hookean"\nbending = 1e-4\n'
    capsule.write_text(text)
    asked = [capsule if word == "CAPSULE" else word for word in BATCH]
    result = run(*asked, "--mean-velocity", "3 mm/s", "--capsules", 4, "--json")
    assert result.exit_code == 0, result.output
    assert list(json.loads(result.stdout)["prior_sds"]) == ["pre_inflation"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((*BATCH, "--flows", "2"), "flow: --flows: expected --membrane with it, got 2 without"),
        ((*BATCH, *KNOWN, "--simulate", "5"), "--simulate: expected no such option with the membrane unknown, got 5"),
        ((*BATCH, *KNOWN, "--mean-velocity", "fast"), "--mean-velocity: expected"),
        ((*BATCH, *KNOWN, "--guess", "stiff"), "--guess: law: expected one of"),
        (("map", "--like", "CAPSULE", "--guess", "hardening=1"), "map: --guess: expected --membrane with it, got"),
        (("map", "--like", "CAPSULE", "--membrane", "unknown", "--noises", "3"), "--noises: expected no such option"),
        (("map", *LAB, "--outline-error", "0.01", "--experiment", "CHANNEL"), "--outline-correlation: expected one"),
        (("map", *LAB), "sensitivity: errors: expected --like CAPSULE, or --experiment with --extent-error"),
        (("map", "--like", "CAPSULE", *LAB), "--extent-error: expected no such option together with --like, got 0.01"),
        ((*FLOW, "--shear-modulus", "50", "--radius", "24 um"), "flow: --shear-modulus: expected a text in N/m"),
        ((*FLOW, "--shear-modulus", "50 mN/m", "--radius", "90 um"), "capsule_radius: expected a radius between"),
        (("sobol", "CAPSULE", "--range", "viscosity"), "--range: expected NAME=RANGE, got 'viscosity'"),
        (("sobol", "CAPSULE", "--range", "viscosity=1 Pa s"), "--range: viscosity: expected a range like"),
    ],
)
def test_bad_input_is_one_line(capsule, database, arguments, message):
    places = {"CAPSULE": capsule, "CHANNEL": capsule.parent / "channel.toml"}
    model = () if {"--membrane", "--flows", "--guess"} & {*arguments} else ("--database", database)
    result = run(*(places.get(one, one) for one in arguments), *model)
    assert isinstance(result.exception, CapsbayesError)
    assert message in str(result.exception)
    assert "\n" not in str(result.exception)
