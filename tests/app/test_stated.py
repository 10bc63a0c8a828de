"""Names of uploaded files, and the commands that repeat the work of a page."""

import shlex
from itertools import pairwise
from pathlib import Path

import pytest

from capsbayes.app.stated import Stated, measure_command, new_folder, page_words, safe_name
from capsbayes.errors import InputError
from capsbayes.status import Status

NAMES = [
    ("capsule.png", "capsule.png"),
    ("../../etc/passwd.png", "passwd.png"),
    ("C:\\temp\\My capsule (3).TIF", "My-capsule-3.tif"),
    ("..png", "picture.png"),
    (".png", None),
    ("$(rm -rf x).png", "rm-rf-x.png"),
    ("overlay.png", "picture-overlay.png"),
    ("écran.jpg", "cran.jpg"),
    ("-.jpg", "picture.jpg"),
    ("x" * 300 + ".png", "x" * 60 + ".png"),
    ("page.html", None),
    ("capsule.png\n.sh", None),
]


def test_the_page_names_no_option_of_a_command():
    for status in Status:
        assert "--" not in page_words(status)
    error = InputError("a--b.rtdc", "rate", "one", "none", 'give --flow-rate "0.16 uL/s", or --shared-velocity')
    words = 'a--b.rtdc: rate: expected one, got none; give flow rate "0.16 uL/s", or shared velocity'
    assert page_words(error) == words


def test_an_uploaded_file_gets_a_harmless_name_and_a_folder_of_its_own(tmp_path):
    assert [safe_name(given) for given, _ in NAMES] == [kept for _, kept in NAMES]
    folders = [new_folder(tmp_path / "bench", "capsule").name for _ in range(3)]
    assert folders == ["capsule", "capsule-2", "capsule-3"]


def test_the_commands_state_what_is_stated_and_nothing_else():
    stated = Stated(
        "capsule.png", velocity="6.2 +/- 0.06 mm/s", walls="12.5, 187.0", wall_error="2", membrane="unknown"
    )
    change, identify, report = map(shlex.split, stated.commands(Path("/my bench/capsule")))
    assert change == ["cd", "/my bench/capsule"]
    assert identify[:5] == ["capsbayes", "identify", "capsule.png", "--experiment", "experiment.toml"]
    options = dict(zip(identify[5::2], identify[6::2], strict=True))
    assert options == {
        "--velocity": "6.2 +/- 0.06 mm/s",
        "--walls": "12.5, 187.0",
        "--wall-error": "2",
        "--membrane": "unknown",
        "--engine": "quadrature",
        "--seed": "1",
        "--out": ".",
    }
    assert report == ["capsbayes", "report", ".", "--out", "report.html"]


def test_priors_are_stated_in_the_words_of_the_person_and_go_on_to_the_next_picture():
    known = {"surface_shear_modulus": "log-uniform 1 .. 1000 mN/m", "capsule_radius": "24 +/- 1 um"}
    stated = Stated("capsule.png", **known)
    _, identify, _ = map(shlex.split, stated.commands(Path("/bench/capsule")))
    assert [after for word, after in pairwise(identify) if word == "--prior"] == [f"{k}={v}" for k, v in known.items()]
    script = stated.script(Path("/bench/capsule"))
    compile(script, "script", "exec")
    assert (
        ", prior=cb.Prior(surface_shear_modulus='log-uniform 1 .. 1000 mN/m', capsule_radius='24 +/- 1 um')" in script
    )
    assert stated.of("next.png").priors() == known
    assert Stated().priors() == {}


EACH = {"--velocity": "6 +/- 1 mm/s", "--flow-rate": "1 uL/s"}
SHARED = {"--pixel-size": "0.34 um", "--shared-velocity": "6 +/- 1 mm/s", "--flow-rate": "1 uL/s"}


@pytest.mark.parametrize(
    ("name", "film", "options"),
    [("a.avi", True, {}), ("a.rtdc", False, SHARED), ("a.png", False, EACH)],
)
def test_each_kind_of_file_is_measured_with_the_options_that_it_takes(name, film, options):
    stated = {"flow_rate": "1 uL/s", "pixel_size": "0.34 um", "flow": ""}
    words = measure_command(name, film=film, velocity="6 +/- 1 mm/s", **stated)
    assert words[:5] == ["capsbayes", "measure", name, "--experiment", "experiment.toml"]
    assert dict(zip(words[5::2], words[6::2], strict=True)) == {**options, "--out": "."}
