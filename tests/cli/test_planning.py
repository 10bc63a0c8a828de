"""The commands of ``sensitivity``: their files and what they print."""

import json

import numpy as np
import pytest
import xarray as xr
from command_line import written

MODEL = ("--database", "manufactured.nc")
BATCH = ("flow", "--shear-modulus", "50 +/- 2 mN/m", "--radius", "22.5 +/- 0.5 um", "--like", "capsule.toml")


@pytest.fixture
def plan(here, capsbayes):
    """A function that plans; exit status and what is printed in one line."""

    def plan(*words):
        status, out, err = capsbayes("sensitivity", *words)
        return status, " ".join((out + err).split())

    return plan


@pytest.fixture
def planned(here, plan):
    """A function that plans and writes, which must end well and print these words; the stored result, and its files."""

    def planned(*words, prints=()):
        status, printed = plan(*words, "--out", "out")
        assert status == 0, printed
        assert [wanted for wanted in prints if wanted not in printed] == []
        stored = next((here / "out").glob("*.json"))
        return json.loads(stored.read_text()), written(here / "out")

    return planned


def test_the_budget_of_a_capsule(planned):
    prints = ("Error budget: G_s =", "mu = 0.85 ± 0.02 Pa s", "L_a =", "model's own error", "seed 1", "Status: Done.")
    stored, files = planned("budget", "capsule.toml", *MODEL, prints=prints)
    assert files == {"budget.json", "budget.csv", "budget.png"}
    shares = [row["share_of_variance"]["surface_shear_modulus"] for row in stored["inputs"].values()]
    assert sum(shares) == pytest.approx(1.0)


def test_the_budget_of_a_capsule_of_unknown_membrane(plan):
    known = ("--membrane", "Blatz-Ko", "--membrane", "bending=1e-4")
    stored = json.loads(plan("budget", "capsule.toml", *known, "--json")[1])
    for name in ("pre_inflation", "area_dilation_modulus"):
        assert stored["inputs"][name]["share_of_variance"]["surface_shear_modulus"] > 0.0
    assert "strain_hardening" not in stored["inputs"]


def test_a_budget_that_leans_on_the_border_ends_with_status_one(here, plan):
    text = (here / "capsule.toml").read_text()
    (here / "capsule.toml").write_text("\n".join(line for line in text.splitlines() if "axial_length" not in line))
    status, printed = plan("budget", "capsule.toml", *MODEL, "--json")
    stored = json.loads(printed)
    assert (status, stored["status"]) == (1, "LEANS_ON_BORDER")
    assert "L_a was not measured" in stored["notes"][0]


def test_sobol_indices_of_a_capsule(plan, planned):
    asked = ("sobol", "capsule.toml", *MODEL, "--samples", 64, "--range", "viscosity=0.8 .. 0.9 Pa s")
    prints = ("mu = 0.8 .. 0.9 Pa s", "L_z =", "448 samples in 64 groups", "Status: Done.")
    stored, files = planned(*asked, prints=prints)
    assert files == {"sobol.json", "sobol.png"}
    assert stored == json.loads(plan(*asked, "--json")[1])
    assert stored["indices"]["capillary_number"]["viscosity"]["total"] == 0.0


def test_the_map_of_a_lab(planned):
    asked = ("map", "--like", "capsule.toml", *MODEL, "--points", 6, 5, "--noises", 3)
    stored, files = planned(*asked, prints=("half of the 68 % interval over the median",))
    assert files == {"map.nc", "map.json", "map.png", "map-radius.png"}
    with xr.open_dataset("out/map.nc", engine="h5netcdf") as widths:
        assert dict(widths.sizes) == {"size_ratio": 5, "capillary_number": 6}
        smallest = float(widths["width_of_surface_shear_modulus"].min())
        assert len(widths.attrs["model_sha256"]) == 64
    assert stored["best"]["width_of_surface_shear_modulus"] >= smallest


def test_the_map_of_an_unknown_membrane(planned):
    known = ("--membrane", "Blatz-Ko", "--membrane", "bending=1e-4", "--guess", "area_dilation_modulus=3")
    prints = ("of ln G_s of one capsule", "lengths unknown", "lengths known", "alpha = 0.05, K = 3, h = 0")
    stored, files = planned("map", "--like", "capsule.toml", *known, "--points", 3, 2, prints=prints)
    assert files == {"map.nc", "map.json", "map.png"}
    assert stored["quantiles"]["unknown_lengths"]["median"] > stored["quantiles"]["known_lengths"]["median"]


def test_the_flow_rate_for_expected_capsules(planned):
    expected = (*BATCH[:3], "--radius", "22.5 um", *BATCH[-2:], *MODEL, "--simulate", 10)
    prints = ("Best: U =", "µL/min", "10 simulated capsules came out at", "at most 5% was asked for")
    stored, files = planned(*expected, prints=prints)
    assert files == {"flow.json", "flow.csv", "flow.png"}
    best = stored["best"]
    assert best["flow_rate"] == pytest.approx(best["mean_velocity"] * 50e-6**2)
    assert best["mean_velocity"] < stored["limit"]["mean_velocity"]
    assert len(np.genfromtxt("out/flow.csv", delimiter=",", names=True)) == len(stored["points"])


def test_flow_rates_for_a_batch_of_unknown_membrane(planned):
    known = ("--membrane", "neo-Hookean", "--membrane", "bending=1e-4", "--guess", "pre_inflation=0.03")
    speeds = ("--mean-velocity", "2 mm/s", "--mean-velocity", "4 mm/s", "--capsules", 6)
    prints = ("6 capsules, filmed in equal shares", "Film at U = 2, 4 mm/s", "tell alpha", "alpha = 0.03", "Slower")
    stored, files = planned(*BATCH, *known, *speeds, prints=prints)
    assert files == {"flow.json", "flow.csv", "flow.png"}
    assert stored["sets"][0]["mean_velocities"] == [2e-3, 4e-3]
    assert len(np.genfromtxt("out/flow.csv", delimiter=",", names=True)) == len(stored["velocities"])


def test_what_a_file_states_of_the_membrane_is_read(here, plan):
    with (here / "capsule.toml").open("a") as file:
        file.write('[membrane]\nlaw = "neo-Hookean"\nbending = 1e-4\n')
    status, printed = plan(*BATCH, "--mean-velocity", "3 mm/s", "--capsules", 4, "--json")
    assert status == 0, printed
    assert list(json.loads(printed)["prior_sds"]) == ["pre_inflation"]
