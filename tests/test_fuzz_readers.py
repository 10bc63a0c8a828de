"""Every reader of a user's file is given damaged and foreign content: it reads it, or refuses it in one line.

A new reader joins by a line in `READERS`. For a longer search:
``CAPSBAYES_FUZZ=2000 python -m pytest -n0 tests/test_fuzz_readers.py``.
"""

import io
import itertools
import json
import os
import re
import shutil
import warnings
from pathlib import Path

import cv2
import h5py
import manufactured
import numpy as np
import openpyxl
import pandas as pd
import pytest
import xarray as xr
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from results import population, posterior

from capsbayes.database import Database, content_hash
from capsbayes.errors import DatabaseError, InputError
from capsbayes.experiment import Experiment
from capsbayes.files.csv_file import read_columns
from capsbayes.image.contour import ContourFile
from capsbayes.image.files import Film, Picture
from capsbayes.image.rtdc import RtdcFile
from capsbayes.infer import Membrane, Posterior, Prior
from capsbayes.measurement import Measurement
from capsbayes.measurement_sets import MeasuredLengths, read_set
from capsbayes.membrane_database import MembraneDatabase
from capsbayes.physics.build import read_cases
from capsbayes.report.write import opened
from capsbayes.run import Store
from evidence.records import Records
from evidence.verification.topic import Results

EXAMPLES = Path(__file__).parents[1] / "examples"
CHANNEL = Experiment(cross_section="square", half_width="25 um", viscosity="0.85 Pa s")
COUNT = int(os.environ.get("CAPSBAYES_FUZZ", "12"))

ANGLE = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
POINTS = np.stack([80.25 + 30.0 * np.cos(ANGLE), 60.5 + 30.0 * np.sin(ANGLE)], axis=1)
CONTOUR = b"x_px,y_px\n" + b"\n".join(b"%.2f,%.2f" % (x, y) for x, y in POINTS)
LABELME = json.dumps({"shapes": [{"label": "c", "points": POINTS.tolist()}]}).encode()
MEASUREMENT = """experiment = "experiment.toml"
[measurement]
axial_extent = "2.1 +/- 0.01"
axial_length = "1.9 +/- 0.01"
length_correlation = 0.5
capsule_velocity = "6.2 +/- 0.06 mm/s"
flow_rate = "1.2 +/- 0.1 uL/min"
doubt = "none"
[prior]
surface_shear_modulus = "50 +/- 10 mN/m"
capsule_radius = { distribution = "log-uniform", low = "10 um", high = "60 um" }
pre_inflation = "0 .. 0.1"
[membrane]
law = "Skalak"
hardening = "1.0 +/- 0.2"
[outline]
file = "outline.csv"
noise = 0.01
correlation = 0.3
white = 0.1
pose = { offset = 0.01, middle = 0.1 }
view = "silhouette"
"""
CHANNEL_TOML = """cross_section = "square"
half_width = "25 +/- 0.2 um"
viscosity = "0.85 +/- 0.02 Pa s"
frame_rate = "2000 Hz"
[camera]
pixel_aspect = "1.0 +/- 0.01"
"""


def of_bytes(content):
    return lambda path: path.write_bytes(content)


def copied(name):
    return lambda path: shutil.copy(EXAMPLES / name, path)


def a_picture(suffix):
    grey = np.random.default_rng(1).integers(0, 255, (24, 32), dtype=np.uint8)
    return cv2.imencode(suffix, grey)[1].tobytes()


def a_stack(path):
    cv2.imwritemulti(str(path), [np.full((24, 32), level, np.uint8) for level in (10, 100, 200)])


def a_roi():
    head = b"Iout" + (228).to_bytes(2, "big") + b"\0\0" + np.array([60, 80, 90, 110, 24], ">i2").tobytes()
    return head.ljust(64, b"\0") + (POINTS.T - np.array([[50.0], [30.0]])).astype(">i2").tobytes()


def a_sheet(path):
    book = openpyxl.Workbook()
    for row in csv_lines():
        book.active.append(row)
    book.save(path)


def csv_lines():
    table = pd.read_csv(EXAMPLES / "batch" / "capsules.csv").head(4)
    return [list(table), *(list(map(str, row)) for row in table.to_numpy().tolist())]


def an_rtdc(path):
    with h5py.File(path, "w") as file:
        file.attrs["imaging:pixel size"], file.attrs["setup:channel width"] = 0.34, 20.0
        file.attrs["imaging:flash duration"] = 2.0
        file["events/image"] = file["events/mask"] = np.full((2, 20, 30), 200, np.uint8)


def a_part(path):
    Store.open(path.parent / "parts", {"a": 1}).save("p", {"x": np.arange(3.0), "text": "t"})
    shutil.copy(path.parent / "parts" / "p.part", path)


def load_part(path):
    shutil.copy(path, path.parent / "parts" / "p.part")
    return Store.open(path.parent / "parts", {"a": 1}).load("p")


def lengths_nc(path):
    frame = pd.read_csv(EXAMPLES / "batch" / "capsules.csv").head(4)
    numbers = {
        "axial_extent": 1.7,
        "axial_extent_error": 0.01,
        "capsule_velocity": 6e-3,
        "capsule_velocity_error": 6e-5,
    }
    columns = {name: ("capsule", value + 0.01 * value * np.arange(4)) for name, value in numbers.items()}
    xr.Dataset(columns | {"name": ("capsule", frame["name"].astype(str).to_numpy(dtype=object))}).to_netcdf(
        path, engine="h5netcdf"
    )


def membrane_database(path):
    few = MembraneDatabase.open("square").taken(np.arange(5)).dataset
    MembraneDatabase(few.assign_attrs(sha256=content_hash(few))).write(path)


def results_file(path):
    Records(path).add({"topic": "t", "item": "i", "seconds": 1.0, "values": {"a": [1.0, 2.0]}, "failed": ""})


def all_of_film(path):
    return list(Film.open(path).frames())


def all_of_rtdc(path):
    return list(RtdcFile.open(path).pictures())


def read_outlines(path):
    return read_set(path, CHANNEL)


def read_outline(path):
    (path.parent / "outline.csv").write_bytes(path.read_bytes())
    return Measurement.read(path.parent / "capsule.toml")


OUTLINE = "z_over_l,y_over_l\n" + "\n".join(f"{1.05 * np.cos(a):.5f},{0.8 * np.sin(a):.5f}" for a in ANGLE) + "\n"

# name: suffix, what writes a valid file, what reads it
READERS = {
    "experiment": (".toml", of_bytes(CHANNEL_TOML.encode()), Experiment.read),
    "measurement": (".toml", of_bytes(MEASUREMENT.encode()), Measurement.read),
    "prior": (".toml", of_bytes(MEASUREMENT.encode()), Prior.read),
    "membrane": (".toml", of_bytes(MEASUREMENT.encode()), Membrane.read),
    "outline": (".csv", of_bytes(OUTLINE.encode()), read_outline),
    "table": (".csv", copied("batch/capsules.csv"), MeasuredLengths.read),
    "sheet": (".xlsx", a_sheet, MeasuredLengths.read),
    "lengths": (".nc", lengths_nc, MeasuredLengths.read),
    "outlines": (".nc", copied("shared_membrane/outlines.nc"), read_outlines),
    "cases": (".csv", of_bytes(b"capillary_number,size_ratio\n0.05,0.9\n0.06,0.95\n"), read_cases),
    "contour": (".csv", of_bytes(CONTOUR), ContourFile.read),
    "ROI": (".roi", of_bytes(a_roi()), ContourFile.read),
    "LabelMe": (".json", of_bytes(LABELME), ContourFile.read),
    "PNG": (".png", of_bytes(a_picture(".png")), Picture.read),
    "TIFF": (".tif", of_bytes(a_picture(".tif")), Picture.read),
    "JPEG": (".jpg", of_bytes(a_picture(".jpg")), Picture.read),
    "stack": (".tif", a_stack, all_of_film),
    "video": (".avi", copied("pictures/film.avi"), Film.open),
    "rtdc": (".rtdc", an_rtdc, all_of_rtdc),
    "database": (".nc", lambda path: manufactured.database(4, 3).write(path), Database.read),
    "membrane database": (".nc", membrane_database, MembraneDatabase.read),
    "posterior": (".nc", lambda path: posterior().write(path), Posterior.read),
    "population": (".nc", lambda path: population().write(path), opened),
    "part": (".part", a_part, load_part),
    "results": (".jsonl", results_file, lambda path: Results.read(Records(path), "t").value("i", "a")),
    "columns": (".csv", copied("pictures/contour.csv"), read_columns),
}  # fmt: skip

HDF5 = b"\x89HDF"
NASTY = [b"", b"\0", *b'nan inf 1e999 -1 0 true [] [[1]] {} "" "x" null'.split(), b"9" * 400, b"1" + b"0" * 400]
NASTY += [b"\xff\xfe", b"\xef\xbb\xbf", b",", b";", b"\t", b"\n", b"\r", *b"= \" ' { 1979-05-27".split(), b"[1, 2]"]
NASTY += [b"{ a = 1 }", "é\u2028".encode(), b'"1e999 um"', b'"nan +/- 1 um"', b'"0 +/- 0 um"', b'"/dev/zero"', b"NA"]
NASTY += [b"1,5", b"mean", b"[" * 2000, b'{"a":' * 2000, b"0x10", b"1_0"]
VALUES = [np.nan, np.inf, -1, 0, 2**63 - 1, "", "x", "{}", "[]", "null", "NaN", "[1]", b"\xff", np.zeros(0)]
VALUES += [np.zeros((2, 0, 3)), np.array(["a"], "S1"), np.array([b"a", b"b"], dtype=object), np.ones((3, 3))]
VALUES += [np.arange(5), np.float32(1.0), True, h5py.Empty("f8")]


@st.composite
def damaged(draw, raw):
    """Bytes of a file, of which some are cut, changed, moved, or replaced by what parsers stumble over."""
    for _ in range(draw(st.integers(1, 3))):
        words = [match.span() for match in itertools.islice(re.finditer(rb"[\w.+-]+|\"[^\"\n]*\"", raw), 400)]
        kinds = ["word", "word", "word", "cut", "byte", "insert", "twice", "random"]
        what = draw(st.sampled_from(["cut", "random"] if raw.startswith(HDF5) else kinds))  # HDF5 aborts on others
        place = draw(st.integers(0, len(raw)))
        nasty = draw(st.sampled_from(NASTY))
        if what == "word" and words:
            start, end = draw(st.sampled_from(words))
            raw = raw[:start] + nasty + raw[end:]
        elif what == "cut":
            raw = raw[:place]
        elif what == "byte":
            raw = raw[:place] + bytes([draw(st.integers(0, 255))]) + raw[place + 1 :]
        elif what == "twice":
            raw = raw[:place] + raw
        elif what == "random":
            raw = draw(st.binary(max_size=200))
        else:
            raw = raw[:place] + nasty + raw[place:]
    return raw


def changed_hdf5(draw, raw):
    """Return an HDF5 file of which one attribute, variable or group is removed or replaced."""
    content = io.BytesIO(raw)
    with h5py.File(content, "r+") as file:
        places = [("/", name) for name in file.attrs]
        datasets = []
        file.visititems(lambda name, node: (datasets.append(name), places.extend((name, key) for key in node.attrs)))
        places = [place for place in places if not place[1].isupper()]  # HDF5 aborts on wrong dimensions
        node = draw(st.sampled_from([*places, *((None, name) for name in datasets)]))
        value = draw(st.sampled_from(VALUES))
        removed = draw(st.booleans()) and draw(st.booleans())
        where, name = node
        holder = file.attrs if where == "/" else file if where is None else file[where].attrs
        if name not in holder:
            return raw
        text = holder[name] if where is not None else None
        if isinstance(text, str) and text.startswith("{") and draw(st.booleans()):
            words = [match.span() for match in re.finditer(r"[\w.+-]+|\"[^\"]*\"", text)]
            start, end = draw(st.sampled_from(words or [(0, 1)]))
            value = text[:start] + draw(st.sampled_from(["null", "NaN", "[]", "{}", '"x"', "-1", "1e999"])) + text[end:]
        del holder[name]
        if not removed:
            holder[name] = value
    return content.getvalue()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("fuzz")
    (made / "experiment.toml").write_text(CHANNEL_TOML)
    (made / "outline.csv").write_text(OUTLINE)
    (made / "capsule.toml").write_text(MEASUREMENT)
    return made


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # of files that h5netcdf opens in part
@pytest.mark.parametrize("name", READERS)
def test_a_reader_reads_or_refuses(folder, name):
    suffix, write, read = READERS[name]
    path = folder / f"{name}{suffix}"
    write(path)
    read(path)
    raw = path.read_bytes()

    @settings(
        max_examples=COUNT, derandomize=True, deadline=None, database=None,
        suppress_health_check=list(HealthCheck), phases=[Phase.generate],
    )  # fmt: skip
    @given(st.data())
    def check(data):
        if raw.startswith(HDF5) and data.draw(st.integers(0, 4)):
            content = changed_hdf5(data.draw, raw)
        else:
            content = data.draw(damaged(raw))
        path.unlink()
        path.write_bytes(content)
        with warnings.catch_warnings(action="ignore"):
            try:
                read(path)
            except (InputError, DatabaseError) as error:
                assert len(str(error).splitlines()) == 1  # noqa: PT017

    try:
        check()
    finally:
        (folder / "outline.csv").write_text(OUTLINE)
