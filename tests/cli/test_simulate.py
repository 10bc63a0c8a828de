import json

import meshio
import numpy as np
import pytest
from command_line import mistake, run, written

CASE = ("--ca", "0.05", "--size-ratio", "0.8")
COARSE = ["simulate", "--refinement", "4", "--bending", "1e-3"]


def test_prints_and_writes_what_it_found(monkeypatch, capsys, tmp_path):
    vtu, png = tmp_path / "state.vtu", tmp_path / "shape.png"
    status, out, _ = run(monkeypatch, capsys, *COARSE, *CASE, "--json", "--paraview", vtu, "--plot", png)
    result = json.loads(out)
    assert status == 0
    assert result["status"] == "DONE"
    assert result["axial_extent"] == pytest.approx(1.485, rel=0.02)
    assert result["velocity_ratio"] == pytest.approx(1.413, rel=0.01)
    mesh = meshio.read(vtu)
    assert mesh.cells_dict["triangle6"].shape == (8 * 4**2, 6)
    assert np.ptp(mesh.points[:, 2]) == pytest.approx(result["silhouette_extent"], rel=0.01)
    assert png.read_bytes().startswith(b"\x89PNG")
    assert written(tmp_path) == {"shape.png", "state.vtu"}


def test_text_names_every_quantity_and_the_membrane(monkeypatch, capsys):
    law = "general:area_dilation_modulus=2,strain_hardening=0.5"
    status, out, _ = run(monkeypatch, capsys, *COARSE, *CASE, "--law", law, "--bending-energy", "curvature")
    assert status == 0
    for symbol in ("L_z / l", "L_a / l", "L_p / l", "v_o / U", "Lambda", "dP+ l / (mu U)"):
        assert symbol in out
    named = "general K_s/G_s = 2, h = 0.5, square cross-section, refinement 4, bending 0.001 of the curvature"
    assert named in " ".join(out.split())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--ca", "-1", "--size-ratio", "0.8"], "capillary_number: expected a number between 0 and 10, got -1"),
        (["--ca", "nan", "--size-ratio", "0.8"], "--ca: expected a finite number, got nan"),
        (["--ca", "0.05", "--size-ratio", "2"], "size_ratio: expected a number between 0.2 and 1.3, got 2"),
        ([*CASE, "--law", "rubber"], "law: expected one of neo-hookean, skalak:hardening"),
        ([*CASE, "--paraview", "state.stl"], "--paraview: expected a file name that ends in .vtu"),
        ([*CASE, "--plot", "no/such/s.png"], "--plot: expected a folder that exists"),
        ([*CASE, "--bending-energy", "rubber"], "bending_energy: expected one of displacement, curvature"),
        ([*CASE, "--refinement", "2"], "refinement: expected at least 4, got 2"),
    ],
)
def test_mistakes_are_one_line_and_status_2(monkeypatch, capsys, arguments, message):
    assert message in mistake(monkeypatch, capsys, "simulate", *arguments)
