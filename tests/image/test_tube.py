"""The real capsule of Risso et al. 2006 (doi 10.1017/S0022112005007652) in a circular tube, flowing to the right."""

import re
import runpy
import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import pytest

from capsbayes.image.files.picture import Picture
from capsbayes.image.measure import detect
from capsbayes.status import Status

EXAMPLE = Path(__file__).parents[2] / "examples" / "tube_capsule" / "tube_capsule.py"
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


@pytest.mark.slow
def test_the_example_tells_what_fits_and_what_does_not(tmp_path):
    """Compression told K_s = 0.55 N/m; the rear of the real capsule is askew, as that of no simulated one is."""
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(StringIO()) as printed:
        patch.setattr(sys, "argv", [str(EXAMPLE), str(FOLDER), "--out", str(tmp_path)])
        runpy.run_path(str(EXAMPLE), run_name="__main__")
    skalak = re.search(r"Skalak, C = 1 +lengths +K_s \S+ N/m \[(\S+), (\S+)\].* DONE", printed.getvalue())
    assert skalak is not None
    assert float(skalak[1]) < 0.55 < float(skalak[2])
    unknown = re.search(r"membrane unknown +lengths +K_s \S+ N/m \[(\S+), (\S+)\]", printed.getvalue())
    assert float(unknown[1]) < 0.55 < float(unknown[2])
    assert len(re.findall(r"silhouette .* OUTLINE_MISFIT", printed.getvalue())) == 3
    assert {path.suffix for path in tmp_path.iterdir()} == {".png", ".html"}
