"""The commands ``diagnose`` and ``hide``, also with effects of a user's own."""

import hashlib
import json
from pathlib import Path

import pytest
from command_line import written
from sessions import drawn_session

from capsbayes import Session, Surrogate
from capsbayes.cli.effects_file import own_effects
from capsbayes.effects import MotionBlur, catalogue
from capsbayes.errors import BrokenPromiseError, CapsbayesError

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "own_effect" / "own_effect.py"
IMPORTS = """
from dataclasses import dataclass
from capsbayes.effects import Halo
from capsbayes.effects.analytic import displaced
from capsbayes.parameters import Parameter
"""
GLARE = """
@dataclass(frozen=True)
class Glare(Halo):
    name = "glare"
    parameter = Parameter("glare", "g", "g", "m", "µm", 1e6, "displacement of the edge")
    def __call__(self, model, theta, *, outline=False):
        distance = theta["glare"] / theta["half_width"]
        return displaced(model(theta, outline=outline), distance, 0.0 * distance)
"""
HALF_WIDTH = IMPORTS + GLARE.replace('"glare", "g"', '"half_width", "g"')
BARE = "class Bare:\n    parameter = 1\n    def __call__(self, model, theta, *, outline=False): ...\n"


@pytest.fixture(scope="module")
def model():
    return Surrogate.open("square-neo-hookean")


@pytest.fixture
def diagnose(here, monkeypatch, capsbayes):
    """A function that runs a diagnosis, which must end well; what is printed, in one line."""
    monkeypatch.setenv("COLUMNS", "160")

    def diagnose(*words):
        status, out, err = capsbayes("diagnose", *words)
        assert status == 0, err
        return " ".join((out + err).split())

    return diagnose


def test_a_right_model_is_not_accused(diagnose):
    printed = diagnose("set", "--out", "study")
    for words in (
        "No disagreement was found between the capsules and square-neo-hookean.", "Lengths alone were given",
        "Deviations of 24 capsules from the model", "trend of ln G_s", "p-value", "model square-neo-hookean, sha256",
        "study.html, study.json",
    ):  # fmt: skip
        assert words in printed
    assert written(Path("study")) == {"study.html", "study.json"}
    stored = json.loads(Path("study/study.json").read_text())
    assert (stored["verdict"], stored["capsules"]) == ("NONE", 24)
    assert set(map(len, stored["files"].values())) == {64}
    assert Path("study/study.html").read_text().startswith("<!DOCTYPE html>")


def test_candidates_are_tried_at_another_level(diagnose):
    asked = ("set", "--level", "1", "--candidates", "halo, motion blur")
    stored = json.loads(diagnose(*asked, "--seed", "2", "--json"))
    assert (stored["seed"], stored["level"]) == (2, 1.0)
    assert {row["parameter"] for row in stored["candidates"]} == {"halo", "exposure"}
    printed = diagnose(*asked[:-1], "halo")
    assert "Explanations that were tried" in printed
    assert "delta =" in printed


def test_one_modulus_is_asked_without_any_effect(diagnose, capsbayes):
    printed = diagnose("set", "--invariance")
    assert "The apparent G_s may be the same at every velocity and size: p-value" in printed
    assert "Explanations" not in printed
    for words in (("--candidates", "halo"), ("--measured", "halo=0.3 +/- 0.1 um")):
        status, _, error = capsbayes("diagnose", "set", "--invariance", *words)
        assert status == 2
        refusal = "--invariance: expected no --candidates, --effects or --measured beside it: no effect is tried"
        assert f"{refusal}, got {words[1]}" in " ".join(error.split())


def test_a_table_with_an_experiment_and_what_is_left_out(diagnose, model):
    table = Path("twelve.csv")
    drawn_session(model, 12, seed=7)[0].write(table)
    columns = table.read_text().splitlines()[0].count(",")
    with table.open("a") as file:
        file.write(f"[bad],2.1{',' * (columns - 1)}\n")
    printed = diagnose(table, "--experiment", "set/experiment.toml")
    assert "1 capsule was left out: " in printed
    assert "capsule [bad]" in printed


@pytest.mark.slow
def test_an_effect_is_named_and_pictured(diagnose, model):
    session, _ = drawn_session(model + MotionBlur(), 24, seed=7, outline=True, sizes={"exposure": 4e-4})
    session.write(Path("blurred"))
    printed = diagnose("blurred", "--candidates", "exposure,halo", "--seed", "3", "--out", "study")
    assert "motion blur explains it: t_e =" in printed
    assert "Capsules predicted with the size that the other half tells" in printed
    assert "gap: rms distance of measured and predicted edge" in printed
    assert Path("study/study.html").read_text().count("data:image/svg+xml") == 6


@pytest.mark.slow
def test_a_set_is_blind_and_its_truth_sealed(capsbayes, tmp_path):
    options = ["--effect", "halo", "--effect-size", "0.4 um", "--capsules", "2", "--refinement", "4", "--workers", "1"]
    assert capsbayes("hide", *options, "--out", tmp_path / "set")[0] == 0
    session = Session.read(tmp_path / "set")
    assert len(session) == 2
    assert all(capsule.outline is not None for capsule in session.measurements)
    truth = (tmp_path / "set.truth" / "truth.json").read_text()
    assert json.loads(truth)["effect"] == "halo"
    assert json.loads(truth)["size"] == pytest.approx(4e-7)
    assert hashlib.sha256(truth.encode()).hexdigest() in (tmp_path / "set" / "seal.txt").read_text()
    assert not any("halo" in path.read_text() for path in (tmp_path / "set").iterdir())


def read(tmp_path, text, model):
    path = tmp_path / "mine.py"
    path.write_text(text)
    return own_effects(path, catalogue(), model)


def test_the_effects_of_a_file_are_found_and_checked(tmp_path, model):
    own = own_effects(EXAMPLE, catalogue(), model)
    assert list(own.effects) == ["flank_shift"]
    assert own.described["effects_file"]["sha256"] == own.sha256
    assert len(own.sha256) == 64
    assert own_effects(None, catalogue(), model).described == {}
    one = read(tmp_path, IMPORTS + GLARE + "mine = Glare()\n", model)  # the object, not the class again
    assert list(one.effects) == ["glare"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = (", "mine.py: line 1: expected Python, got '(' was never closed"),
        ("\n\nraise ValueError('no')", "mine.py: line 3: expected Python that runs, got ValueError: no"),
        ("import sys; sys.exit(0)", "mine.py: line 1: expected Python that runs, got SystemExit: 0"),
        (IMPORTS, "mine.py: expected an effect: a class with"),  # those that are imported do not count
        (IMPORTS + "mine = Halo()\n", "mine: expected a name that is not taken, got 'halo', that of halo in the"),
        (HALF_WIDTH, "Glare: expected a name that is not taken, got 'half_width', that of an input of the models"),
        (IMPORTS + GLARE + GLARE.replace("class Glare", "class Gloss"), "got 'glare', that of Glare; choose another"),
        (IMPORTS + GLARE + "    def __init__(self, size): pass\n", "mine.py: Glare: expected a class that is made"),
        (BARE, "mine.py: Bare: expected an effect with name, parameter"),
    ],
)
def test_a_mistake_in_the_file_is_one_line(tmp_path, model, text, message):
    with pytest.raises(CapsbayesError) as error:
        read(tmp_path, text, model)
    assert message in str(error.value)


def test_a_broken_promise_is_named_with_the_file(tmp_path, model):
    idle = GLARE.partition("    def __call__")[0] + (
        "    def __call__(self, model, theta, *, outline=False):\n        return model(theta, outline=outline)\n"
    )
    with pytest.raises(BrokenPromiseError, match=r"mine\.py: Glare breaks its promise: at a typical size"):
        read(tmp_path, IMPORTS + idle, model)


def test_an_effect_of_a_users_own_is_hidden_in_stored_shapes_and_tried(diagnose, capsbayes, mistaken):
    """Lengths alone, few candidates: the tutorial does it with outlines and all of them."""
    Path("mine.py").write_text(IMPORTS + GLARE)
    shapes = ("--shapes", ROOT / "data" / "pools" / "none-0.nc", "--capsules", "14", "--lengths-only")
    hide = ("hide", "--effects", "mine.py", *shapes, "--out", "hidden")
    assert "glare" in mistaken(*hide, "--effect", "glow")
    assert capsbayes(*hide, "--effect", "glare", "--effect-size", "0.5 um")[0] == 0
    assert json.loads(Path("hidden.truth/truth.json").read_text())["effect"] == "glare"
    words = ("hidden", "--effects", "mine.py", "--candidates", "glare", "--level", "1", "--json")
    study = json.loads(diagnose(*words))
    assert study["effects_file"]["effects"] == ["glare"]
    assert [row["parameter"] for row in study["candidates"]] == ["glare"]
