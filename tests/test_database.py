"""A database comes back from its file as it went, or says in one line why not."""

from __future__ import annotations

import os
import shutil

import h5py
import numpy as np
import pytest
import xarray as xr

from capsbayes.database import ATTRIBUTES, VARIABLES, Database, content_hash
from capsbayes.errors import DatabaseError, InputError

CASES, NODES, POINTS = 5, 7, 16


def arrays(cases=CASES):
    rng = np.random.default_rng(1)
    size = {"case": cases, "node": NODES, "axis": 3, "point": POINTS, "plane": 2, "border": 2}
    values = {}
    for name, variable in VARIABLES.items():
        shape = tuple(size[dim] for dim in variable.dims)
        values[name] = rng.integers(1, 9, shape) if variable.kind == "i" else rng.random(shape)
    values["status"] = np.array(["DONE", "DONE", "NO_STEADY_STATE", "DONE", "NOT_CONVERGED"])[:cases]
    values["border_kind"] = np.array(["limit of existence", "limit of the database"])
    values["axial_extent"][2] = np.nan
    values["effect_value"] = np.array([0.0, 0.1, 0.0, 0.1, 0.1])[:cases]
    values["border_effect_value"] = np.array([0.0, 0.1])
    return {name: value for name, value in values.items() if name not in ("axis", "plane")}


def attributes():
    values = dict.fromkeys(ATTRIBUTES, "text") | {
        "bending": 2e-4,
        "pre_inflation": 0.0,
        "null_value": 0.0,
        "settings": '{"refinement": 8}',
    }
    del values["sha256"]
    return values


@pytest.fixture
def database():
    return Database.assemble(arrays(), attributes())


@pytest.fixture
def file(database, tmp_path):
    path = tmp_path / "shapes.nc"
    database.write(path)
    return path


def test_comes_back_as_it_went(database, file, tmp_path):
    back = Database.read(file)
    assert back.sha256 == database.sha256
    assert len(back) == CASES
    assert back.settings == {"refinement": 8}
    for name in VARIABLES:
        assert back[name].dtype.kind == VARIABLES[name].kind
        np.testing.assert_array_equal(back[name], database[name])
    database.write(tmp_path / "again.nc")
    assert (tmp_path / "again.nc").read_bytes() == file.read_bytes()


def test_plain_xarray_reads_names_units_and_coordinates(file):
    with xr.open_dataset(file, engine="h5netcdf") as dataset:
        assert dict(dataset.sizes) == {"case": 5, "node": 7, "axis": 3, "point": 16, "plane": 2, "border": 2}
        assert dataset["axial_extent"].attrs == {
            "long_name": "maximum extension along the flow",
            "symbol": "L_z",
            "units": "l",
        }
        assert list(dataset["plane"].values) == ["z", "y"]
        assert dataset["nodes"].sel(axis="z").shape == (5, 7)
        assert list(dataset["status"].values[:3]) == ["DONE", "DONE", "NO_STEADY_STATE"]
        assert dataset.attrs["bending"] == 2e-4
        for name in VARIABLES:
            assert all(dataset[name].attrs[key] for key in ("long_name", "symbol", "units"))


def test_converged_keeps_the_done_rows_only(database, tmp_path):
    done = database.converged
    assert len(done) == 3
    assert set(done["status"]) == {"DONE"}
    np.testing.assert_array_equal(done["capillary_number"], database["capillary_number"][[0, 1, 3]])
    np.testing.assert_array_equal(done["border_size_ratio"], database["border_size_ratio"])
    assert done.sha256 == database.sha256
    done.write(tmp_path / "done.nc")
    assert len(Database.read(tmp_path / "done.nc")) == 3


def test_a_compact_database_lacks_the_nodes_and_has_outlines_in_single_precision(database, tmp_path):
    slim = database.compact()
    assert slim.dataset.sizes["node"] == 0
    for name in VARIABLES.keys() - {"nodes", "axis", "plane", "profile", "silhouette"}:
        np.testing.assert_array_equal(slim[name], database[name], err_msg=name)
    for name in ("profile", "silhouette"):
        np.testing.assert_allclose(slim[name], database[name], rtol=0, atol=1e-7, err_msg=name)
    slim.write(tmp_path / "slim.nc")
    read = Database.read(tmp_path / "slim.nc")
    assert read["profile"].dtype == np.float64
    np.testing.assert_array_equal(read["profile"], slim["profile"])
    assert read.sha256 != database.sha256


def test_the_rows_of_one_value_of_an_effect(database):
    np.testing.assert_array_equal(database.values, [0.0, 0.1])
    one = database.at_value(0.1)
    np.testing.assert_array_equal(one["capillary_number"], database["capillary_number"][[1, 3, 4]])
    np.testing.assert_array_equal(one["border_size_ratio"], database["border_size_ratio"][1:])
    assert one.sha256 == database.sha256
    assert len(database.at_value(0.05)) == 0


def test_hash_knows_every_value_and_the_pedigree_but_not_the_date(database):
    assert Database.assemble(arrays(), attributes() | {"created": "another day"}).sha256 == database.sha256
    assert Database.assemble(arrays(), attributes() | {"law": "another"}).sha256 != database.sha256
    changed = arrays()
    changed["profile"][3, 2, 1] = np.nextafter(changed["profile"][3, 2, 1], 1.0)
    assert Database.assemble(changed, attributes()).sha256 != database.sha256
    renamed = arrays()
    renamed["status"][4] = "UNRESOLVED"
    assert Database.assemble(renamed, attributes()).sha256 != database.sha256


def test_the_cross_section_has_its_older_name_in_older_files(database, tmp_path):
    file = tmp_path / "older.nc"
    dataset = database.dataset.assign_attrs(section="square", settings='{"section": "square"}')
    del dataset.attrs["cross_section"]
    dataset.assign_attrs(sha256=content_hash(dataset)).to_netcdf(file, engine="h5netcdf")
    older = Database.read(file)
    assert older.dataset.attrs["cross_section"] == older.settings["cross_section"] == "square"
    assert older.sha256 == content_hash(dataset)


def cut_to(share):
    return lambda path: path.write_bytes(path.read_bytes()[: int(share * path.stat().st_size)])


def without_variable(path):
    with h5py.File(path, "a") as raw:
        del raw["velocity_ratio"]


def without_attribute(path):
    with h5py.File(path, "a") as raw:
        del raw.attrs["law"]


def changed(path):
    with h5py.File(path, "a") as raw:
        raw["velocity_ratio"][1] += 1e-12


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (os.remove, "no such file$"),
        *((cut_to(share), ".*(damaged|missing)") for share in (0.0, 0.1, 0.5, 0.99)),
        (lambda path: path.write_text("Ca,a/l\n0.05,0.9\n"), "not a readable NetCDF file"),
        (without_variable, "variable velocity_ratio is missing$"),
        (without_attribute, "attribute law is missing$"),
        (changed, "its content does not match its sha256"),
    ],
)
def test_a_damaged_file_is_refused_in_one_line(file, damage, message):
    damage(file)
    with pytest.raises(DatabaseError, match=rf"shapes\.nc: {message}") as caught:
        Database.read(file)
    assert "\n" not in str(caught.value)


def test_wrong_shape_and_unknown_status_are_refused():
    with pytest.raises(DatabaseError, match=r"database: nodes: expected dimensions \('case', 'node', 'axis'\)"):
        Database.assemble(arrays() | {"nodes": np.zeros((5, 7))}, attributes())
    with pytest.raises(DatabaseError, match=r"expected names of capsbayes\.Status, got FINE"):
        Database.assemble(arrays() | {"status": ["FINE"] * 5}, attributes())


def test_a_failed_write_leaves_the_old_file_and_no_litter(database, file, monkeypatch):
    before = file.read_bytes()

    def break_off(*args):
        raise OSError("disk full")

    monkeypatch.setattr(os, "replace", break_off)
    with pytest.raises(InputError, match="disk full"):
        database.write(file)
    assert file.read_bytes() == before
    assert [path.name for path in file.parent.iterdir()] == ["shapes.nc"]


def test_open_finds_a_shipped_file(file, tmp_path, monkeypatch):
    import capsbayes.database as module

    shutil.copy(file, tmp_path / "square-test.nc")
    monkeypatch.setattr(module, "shipped_folders", lambda kind: (tmp_path / "none", tmp_path))
    assert len(Database.open("square-test")) == CASES
    with pytest.raises(DatabaseError, match=r"no database 'pentagon' comes with the library; it has .*square-test"):
        Database.open("pentagon")
