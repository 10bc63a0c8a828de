"""The file of scattered states: written and read the same, and refused when it was changed."""

import numpy as np
import pytest
import xarray as xr

from capsbayes.errors import DatabaseError
from capsbayes.membrane_database import NULL_VALUES, RANGES, MembraneDatabase, covered, highest_ca, lowest_ca


@pytest.fixture(scope="module")
def some():
    return MembraneDatabase.of(MembraneDatabase.open("square").dataset.isel(state=slice(60)))


def test_a_file_is_read_as_it_was_written(some, tmp_path):
    some.write(tmp_path / "some.nc")
    again = MembraneDatabase.open(tmp_path / "some.nc")
    assert again.sha256 == some.sha256
    for name in some.dataset.data_vars:
        np.testing.assert_array_equal(again[name], some[name], err_msg=name)


def test_a_changed_file_and_an_unknown_name_are_refused(some, tmp_path):
    some.write(tmp_path / "some.nc")
    with xr.open_dataset(tmp_path / "some.nc", engine="h5netcdf") as opened:
        opened.load().assign(slack=2.0 * opened["slack"]).to_netcdf(tmp_path / "other.nc", engine="h5netcdf")
    with pytest.raises(DatabaseError, match="does not match its sha256"):
        MembraneDatabase.open(tmp_path / "other.nc")
    with xr.open_dataset(tmp_path / "some.nc", engine="h5netcdf") as opened:
        opened.load().drop_vars("numbers_along").to_netcdf(tmp_path / "less.nc", engine="h5netcdf")
    with pytest.raises(DatabaseError, match="variable numbers_along is missing"):
        MembraneDatabase.open(tmp_path / "less.nc")
    with pytest.raises(DatabaseError, match=r"no membrane database 'oval' comes with the library; it has .*square"):
        MembraneDatabase.open("oval")


def test_states_that_are_joined_keep_the_errors_of_their_mesh(some):
    own, others = some.taken(range(40)), some.taken(range(40, 60)).dataset
    of_modes = [name for name in others if name.startswith(("profile", "silhouette")) and not name.endswith("_mean")]
    both = own.joined(others.assign({name: -others[name] for name in of_modes}))  # modes of the other sign
    np.testing.assert_array_equal(both["numbers_mesh_error"], some["numbers_mesh_error"])
    for view in ("profile", "silhouette"):
        for name in (view, f"{view}_mesh_error"):
            shapes, wanted = (np.tensordot(each[name], each[f"{view}_modes"], 1) for each in (both, some))
            np.testing.assert_allclose(shapes, wanted, atol=1e-5)  # [l]; modes are kept in single precision
    without = own.joined(others.drop_vars([name for name in others if name.endswith("_mesh_error")]))
    np.testing.assert_array_equal(without["numbers_mesh_error"][:40], some["numbers_mesh_error"][:40])
    assert all(row in some["numbers_mesh_error"][:40] for row in without["numbers_mesh_error"][40:])  # of the nearest


@pytest.mark.parametrize("cross_section", ["square", "circular"])
def test_its_states_lie_where_they_were_sought(cross_section):
    whole = MembraneDatabase.open(cross_section)
    assert covered(whole["values"], cross_section).all()
    assert whole.cross_section == cross_section
    assert np.abs(whole["slack"]).max() < 5e-4  # [U], beyond which the mesh does not resolve a state


def test_the_null_membrane_is_covered_from_the_parachutes_to_the_limit():
    low, high = float(lowest_ca(0.0)), float(highest_ca(1.0, 0.0))
    assert 0.015 < low < 0.02
    assert 0.1 < high < 0.11
    values = np.tile(NULL_VALUES, (3, 1))
    values[:, 0], values[:, 1] = (0.99 * low, 0.06, 1.01 * high), 1.0
    np.testing.assert_array_equal(covered(values), [False, True, False])
    assert RANGES[0][1] == pytest.approx(float(highest_ca(0.8, 1.0)))
