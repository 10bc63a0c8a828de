"""The real capsule of Risso et al. 2006 (doi 10.1017/S0022112005007652) in a circular tube, flowing to the right."""

import re
import runpy
import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import pytest

from capsbayes.image.files import Picture
from capsbayes.image.measure import detect, silhouette_of
from capsbayes.measurement import askew_size
from capsbayes.status import Status

EXAMPLE = Path(__file__).parents[2] / "examples" / "tube_capsule" / "tube_capsule.py"
PAGE = Path(__file__).parents[2] / "evidence" / "results" / "real-capsule.md"
FOLDER = Path(__file__).parents[3] / "shared" / "data" / "capsule_tube"
pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason=f"the recordings are not in {FOLDER}")


@pytest.mark.parametrize("with_background", [True, False])
def test_what_can_be_read_off_the_picture_by_eye_is_found(with_background):
    background = Picture.read(FOLDER / "background.png") if with_background else None
    found = detect(Picture.read(FOLDER / "capsule.png"), background=background, flow="right")
    assert found.status is Status.DONE
    extent, length, _, half_width = found.lengths
    assert 2.0 * half_width == pytest.approx(176.0, abs=1.0)
    assert extent == pytest.approx(134.0, abs=2.5)
    assert 113.5 < length < 118.5  # the rear band is some ten pixels thick
    assert abs(found.walls.tilt) < 0.003


def test_the_other_direction_is_refused():
    assert detect(Picture.read(FOLDER / "capsule.png"), flow="left").status is Status.WRONG_FLOW


def test_the_empty_tube_holds_no_capsule():
    empty = Picture.read(FOLDER / "background.png")
    assert detect(empty, background=empty).status is Status.NO_CAPSULE


def test_the_rear_is_a_band_and_askew():
    """The band of the rear is ten pixels thick, and the edge behind it as blurred as no other one."""
    picture = Picture.read(FOLDER / "capsule.png")
    found = detect(picture, background=Picture.read(FOLDER / "background.png"), flow="right")
    assert 3.5 < found.rear.within < 6.0
    assert np.sqrt(found.covariance[1, 1]) > found.rear.within
    seen = silhouette_of(found)
    assert 0.008 < seen.pose.rear < 0.03
    assert askew_size(seen.points, seen.noise) == pytest.approx(0.008, rel=0.25)


@pytest.mark.slow
def test_the_example_tells_what_the_page_says(tmp_path):
    """Compression told K_s = 0.55 N/m."""
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(StringIO()) as printed:
        patch.setattr(sys, "argv", [str(EXAMPLE), str(FOLDER), "--out", str(tmp_path)])
        runpy.run_path(str(EXAMPLE), run_name="__main__")
    by = "lengths|silhouette|no corners"
    told = dict(re.findall(rf"^(\S.*? (?:{by})) +K_s (.*?\])", printed.getvalue(), re.MULTILINE))
    assert len(told) == 9
    rows = re.findall(rf"^\| ([^|]+) \| ({by}) \| ([^|]+) \|", PAGE.read_text(), re.MULTILINE)
    assert len(rows) == len(told)
    numbers = re.compile(r"\d+\.\d+")
    told = {" ".join(name.split()): [float(each) for each in numbers.findall(text)] for name, text in told.items()}
    for law, how, moduli in rows:
        assert told[f"{law} {how}"] == pytest.approx([float(each) for each in numbers.findall(moduli)], rel=0.03)
    _, low, high = told["membrane unknown lengths"]
    assert low < 0.55 < high
    assert told["membrane unknown no corners"][2] < 0.55
    misfits = [float(each) for each in re.findall(r"misfit (\S+)", printed.getvalue())]
    assert len(misfits) == 5
    assert max(misfits) < 4.0
    assert {path.suffix for path in tmp_path.iterdir()} == {".png", ".html"}
