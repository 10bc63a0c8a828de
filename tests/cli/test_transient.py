import numpy as np
import pytest
from command_line import mistake, run

COARSE = ["transient", "--refinement", "4", "--bending", "1e-3"]


def test_prints_a_table_and_writes_table_series_and_picture(monkeypatch, capsys, tmp_path):
    files = {"--table": tmp_path / "way.csv", "--paraview": tmp_path / "way.pvd", "--plot": tmp_path / "way.png"}
    case = ["--ca", 0.12, "--size-ratio", 0.8, "--until", 0.24, "--every", 0.06]
    status, out, _ = run(monkeypatch, capsys, *COARSE, *case, *(word for pair in files.items() for word in pair))
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
    assert files["--plot"].read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--until", "0"], "until: expected a number between 0 and 1000, got 0"),
        (["--until", "1", "--viscosity-ratio", "5"], "viscosity_ratio: expected 1, because the double layer"),
        (["--until", "1", "--scheme", "magic"], "scheme: expected one of semi-implicit, explicit, got 'magic'"),
        (["--until", "1", "--paraview", "way.vtu"], "--paraview: expected a file name that ends in .pvd"),
        (["--until", "1", "--plot", "no/such/way.png"], "--plot: expected a folder that exists"),
    ],
)
def test_mistakes_are_one_line_and_status_2(monkeypatch, capsys, arguments, message):
    assert message in mistake(monkeypatch, capsys, *COARSE, "--ca", "0.1", "--size-ratio", "0.8", *arguments)
