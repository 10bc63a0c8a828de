"""The commands ``simulate``, ``transient``, ``build`` and ``atlas``."""

import json
from functools import partial
from pathlib import Path

import meshio
import numpy as np
import pytest
from analytic_simulator import AnalyticSimulator
from command_line import written

import capsbayes.physics.simulator as capsbayes_simulator
from capsbayes import Database, Simulator
from capsbayes.physics.build import default_grid
from capsbayes.physics.stokes import WallDiscretisation

COARSE = ("--refinement", "4", "--bending", "1e-3")
CASE = ("simulate", *COARSE, "--ca", "0.05", "--size-ratio", "0.8")
SECTION = ("--corner-radius", "0.1", "--rest-aspect", "1.05")
PNG = b"\x89PNG\r\n\x1a\n"


def test_a_capsule_is_simulated_and_written(capsbayes, tmp_path):
    vtu, png = tmp_path / "state.vtu", tmp_path / "shape.png"
    status, out, _ = capsbayes(*CASE, "--json", "--paraview", vtu, "--plot", png)
    result = json.loads(out)
    assert (status, result["status"]) == (0, "DONE")
    assert result["axial_extent"] == pytest.approx(1.485, rel=0.02)
    assert result["velocity_ratio"] == pytest.approx(1.413, rel=0.01)
    mesh = meshio.read(vtu)
    assert mesh.cells_dict["triangle6"].shape == (8 * 4**2, 6)
    assert np.ptp(mesh.points[:, 2]) == pytest.approx(result["silhouette_extent"], rel=0.01)
    assert png.read_bytes().startswith(PNG)
    assert written(tmp_path) == {"shape.png", "state.vtu"}


def test_the_text_names_every_quantity_and_the_membrane(capsbayes):
    law = "general:area_dilation_modulus=2,strain_hardening=0.5"
    status, out, _ = capsbayes(*CASE, "--law", law, "--bending-energy", "curvature")
    assert status == 0
    for symbol in ("L_z / l", "L_a / l", "L_p / l", "v_o / U", "Lambda", "dP+ l / (mu U)"):
        assert symbol in out
    named = "general K_s/G_s = 2, h = 0.5, square cross-section, refinement 4, bending 0.001 of the curvature"
    assert named in " ".join(out.split())


def test_the_text_states_the_section_that_was_given(monkeypatch, capsbayes):
    coarse = partial(Simulator, walls=WallDiscretisation(spacing=0.16, far_spacing=0.3, end=2.5))
    monkeypatch.setattr(capsbayes_simulator, "Simulator", coarse)
    case = ("--ca", "0.05", "--size-ratio", "0.75", "--refinement", "4", "--pre-inflation", "0.1")
    status, out, _ = capsbayes("simulate", *case, *SECTION)
    assert status == 0
    title = " ".join(out.partition("Done.")[0].split())
    assert title.endswith("pre inflation 0.1, corner radius 0.1, rest aspect 1.05")


def test_a_capsule_is_followed_from_rest(capsbayes, tmp_path):
    files = {"--table": tmp_path / "way.csv", "--paraview": tmp_path / "way.pvd", "--plot": tmp_path / "way.png"}
    case = ("--ca", 0.12, "--size-ratio", 0.8, "--until", 0.24, "--every", 0.06)
    status, out, _ = capsbayes("transient", *COARSE, *case, *(word for pair in files.items() for word in pair))
    assert status == 0
    heading, _, *rows, _, end = out.splitlines()
    assert "L_z / l" in heading
    assert end.startswith("Not yet steady: the fastest node moves at 0.")
    table = np.genfromtxt(files["--table"], delimiter=",", names=True)
    np.testing.assert_allclose(table["time"], [0.0, 0.06, 0.12, 0.18, 0.24])
    np.testing.assert_array_equal(table.tolist(), [tuple(map(float, row.split())) for row in rows])
    assert table["axial_extent"][0] == pytest.approx(1.6, abs=1e-3)
    assert np.all(np.diff(table["velocity_ratio"]) < 0.0)
    assert files["--paraview"].read_text().count("DataSet") == 5
    assert (tmp_path / "way-0004.vtu").is_file()
    assert files["--plot"].read_bytes().startswith(PNG)


@pytest.fixture
def build(here, monkeypatch, capsbayes):
    """A function that builds with a simulator in closed form; exit status, what is printed, and its settings."""
    given = {}

    def simulator(**settings):
        given.update(settings)
        return AnalyticSimulator(refinement=settings["refinement"])

    monkeypatch.setattr(capsbayes_simulator, "Simulator", simulator)

    def run(*words):
        status, out, err = capsbayes(
            "build", "--cases", "cases.csv", "--out", "shapes.nc", "--scheduler", "synchronous", *words
        )
        assert err == ""
        return status, out, given

    return run


def test_the_cases_of_a_file_are_built(build):
    status, printed, given = build("--refinement", "12", *SECTION)
    database = Database.read("shapes.nc")
    assert (status, list(database["capillary_number"]), set(database["refinement"])) == (0, [0.5, 0.05, 0.06], {12})
    for words in ("3 cases in", "     2  Done.", database.sha256):
        assert words in printed
    assert (given["cross_section"], given["corner_radius"], given["section_aspect"]) == ("square", 0.1, 1.0)
    assert given["rest_aspect"] == 1.05


def test_an_effect_is_built(build):
    status, printed, _ = build("--effect", "limit", "--values", "0.16,0.175,0.2")
    database = Database.read("shapes.nc")
    assert (status, "cases in" in printed) == (0, True)
    assert (database.effect, database.null_value, list(database.values)) == ("limit", 0.175, [0.16, 0.175, 0.2])


def test_a_build_prints_json_and_ends_with_1_when_nothing_converged(build):
    assert json.loads(build("--json")[1])["statuses"] == {"DONE": 2, "NO_STEADY_STATE": 1}
    Path("cases.csv").write_text("capillary_number,size_ratio\n0.9,0.9\n")
    assert build()[0] == 1
    assert Path("shapes.nc").exists()


def test_the_default_grid_covers_the_plane_and_is_denser_at_low_ca():
    grid = default_grid()
    capillary_numbers, size_ratios = (sorted(set(values)) for values in zip(*grid, strict=True))
    assert len(grid) == len(set(grid)) == len(capillary_numbers) * len(size_ratios)
    assert (size_ratios[0], size_ratios[-1]) == (0.7, 1.15)
    assert (capillary_numbers[0], capillary_numbers[-1]) == (0.003, 0.15)
    assert capillary_numbers[1] - capillary_numbers[0] < capillary_numbers[-1] - capillary_numbers[-2]


def test_an_atlas_has_a_picture_for_each_map_and_lists_them(here, capsbayes):
    status, printed, _ = capsbayes("atlas", "database.nc", "--out", "atlas", "--json")
    listed = json.loads(printed)
    assert (status, listed["cases"], listed["converged"]) == (0, 48, 47)
    assert listed["sha256"] == Database.read("database.nc").sha256
    names = ("cases", "shapes", "velocity", "velocity-surface", "lengths")
    assert [file["file"] for file in listed["files"]] == [f"atlas/{name}.png" for name in names]
    for file in listed["files"]:
        content = Path(file["file"]).read_bytes()
        assert (len(content), content[:8]) == (file["bytes"], PNG)
    printed = capsbayes("atlas", "database.nc", "--out", "atlas")[1]
    assert "47 of 48 cases with a steady state" in printed
    assert "atlas/cases.png" in printed
