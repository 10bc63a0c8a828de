"""A folder with one good input of each kind, in a copy of which commands are tried."""

import os
import shutil

import cv2
import manufactured
import numpy as np
import pytest
from command_line import mistake, run
from drawn import drawn
from drawn_film import bright, film, written
from drawn_populations import drawn_population
from png_header import png_of_size
from results import posterior
from sessions import drawn_session

from capsbayes.surrogate import Surrogate

EXPERIMENT = 'cross_section = "square"\nhalf_width = "25.0 +/- 0.2 um"\nviscosity = "0.85 +/- 0.02 Pa s"\n'
PLACES = 65.0 + 23.37 * np.arange(5)  # of the capsule of the film
RUBBISH = {
    "nested.toml": f"a = {'[' * 5000}{']' * 5000}".encode(),
    "huge.png": png_of_size(16000, 16000),
    "text.nc": b"no numbers",
    "other.dat": b"nothing that is known",
    "idle.py": b"x = 1\n",
    "bad.csv": b"Ca,size_ratio\n0.1,0.9\n",
    "cells.rtdc": b"\x89HDF\r\n\x1a\n",
}


@pytest.fixture(scope="session")
def picture():
    """A drawn capsule at Ca = 0.08, a/l = 1.05, whose rear is seen."""
    return drawn(0.08, 1.05, half_width=55.0)


@pytest.fixture(scope="session")
def inputs(tmp_path_factory, picture):
    folder, model = tmp_path_factory.mktemp("inputs"), Surrogate.open("square-neo-hookean")
    text = manufactured.capsule_file(folder, EXPERIMENT).read_text()
    for name, change in {
        "misspelt.toml": ("axial_extent", "axial_extend"),
        "long.toml": ('axial_extent = "1', 'axial_extent = "9'),
        "tunnel.toml": ("channel.toml", "no-tunnel.toml"),
        "alone.toml": ('experiment = "channel.toml"\n', ""),
    }.items():
        (folder / name).write_text(text.replace(*change))
    tension = 'cross_section = "square"\nhalf_width = "25 um"\nviscous_tension = "3 mN/m"\n'
    (folder / "experiment.toml").write_text(EXPERIMENT)
    (folder / "tension.toml").write_text(tension)
    (folder / "cases.csv").write_text("size_ratio,capillary_number,note\n0.9,0.05,middle\n0.9,0.06,\n0.8,0.5,high\n")
    np.savetxt(folder / "contour.csv", picture.outline, delimiter=",", header="x_px,y_px", comments="")
    for place in (folder, folder / "pictures"):
        place.mkdir(exist_ok=True)
        for name in ("picture.png", "upright.png"):
            cv2.imwrite(str(place / name), np.rot90(picture.picture, name == "upright.png"))
    for name in ("picture.dat", "picture.rtdc"):
        shutil.copy(folder / "picture.png", folder / name)
    shutil.copy(folder / "picture.png", folder / "picture.csv")
    cv2.imwrite(str(folder / "empty.png"), picture.background)
    written(folder / "film", film(PLACES))
    cv2.imwrite(str(folder / "film.png"), bright(x=PLACES[0]).background)
    drawn_session(model, 4, seed=7)[0].write(folder / "set.csv")
    drawn_session(model, 24, seed=7)[0].write(folder / "set")
    manufactured.database(8, 6, failed=(5,)).write(folder / "database.nc")
    manufactured.database().write(folder / "manufactured.nc")
    posterior().write(folder / "posterior.nc")
    drawn_population(model, 6, seed=1).write(folder / "population.nc")
    (folder / "nothing").mkdir()
    for name, content in RUBBISH.items():
        (folder / name).write_bytes(content)
    return folder


@pytest.fixture
def here(inputs, tmp_path, monkeypatch):
    """A copy of the folder with inputs, in which one works."""
    place = tmp_path / "here"
    shutil.copytree(inputs, place)
    monkeypatch.chdir(place)
    return place


@pytest.fixture
def linked(inputs, monkeypatch):
    """A function that makes a folder with links to the files of the inputs, to work in; none of them may be changed."""

    def linked(place):
        shutil.copytree(inputs, place, copy_function=os.link)
        monkeypatch.chdir(place)

    return linked


@pytest.fixture
def capsbayes(monkeypatch, capsys):
    """A function that runs a command: its words, the last of them perhaps in one text; status, and what is printed."""
    return lambda *words: run(monkeypatch, capsys, *words)


@pytest.fixture
def mistaken(monkeypatch, capsys):
    """A function that runs a command that must end in one line and exit status 2; the line."""
    return lambda *words: mistake(monkeypatch, capsys, *words)
