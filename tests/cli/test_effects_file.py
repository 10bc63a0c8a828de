"""Effects of a user's own: the file of ``--effects`` is run, its effects are checked and join the catalogue."""

import json
from pathlib import Path

import pytest
from command_line import mistake, run

from capsbayes import Surrogate
from capsbayes.cli.effects_file import own_effects
from capsbayes.effects import catalogue
from capsbayes.errors import BrokenPromiseError, CapsbayesError

EXAMPLE = Path(__file__).parents[2] / "examples" / "own_effect" / "own_effect.py"
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


def test_an_effect_is_hidden_in_stored_shapes_and_tried(tmp_path, monkeypatch, capsys):
    """Lengths alone, few candidates: the tutorial does it with outlines and all of them."""
    path, out = tmp_path / "mine.py", tmp_path / "hidden"
    path.write_text(IMPORTS + GLARE)
    shapes = Path(__file__).parents[2] / "data" / "pools" / "none-0.nc"
    hide = ("hide", "--effects", path, "--shapes", shapes, "--capsules", "14", "--lengths-only", "--out", out)
    assert "glare" in mistake(monkeypatch, capsys, *hide, "--effect", "glow")
    assert run(monkeypatch, capsys, *hide, "--effect", "glare", "--effect-size", "0.5 um")[0] == 0
    assert json.loads((tmp_path / "hidden.truth" / "truth.json").read_text())["effect"] == "glare"
    words = ("diagnose", out, "--effects", path, "--candidates", "glare", "--level", "1", "--json")
    status, printed, error = run(monkeypatch, capsys, *words)
    assert status == 0, error
    told = json.loads(printed)
    assert told["effects_file"]["effects"] == ["glare"]
    assert [row["parameter"] for row in told["candidates"]] == ["glare"]


@pytest.mark.parametrize("command", ["diagnose", "hide"])
def test_each_command_refuses_a_bad_file(tmp_path, monkeypatch, capsys, command):
    path = tmp_path / "mine.py"
    path.write_text("x = 1\n")
    words = {
        "diagnose": (EXAMPLE.parents[1] / "drifting_modulus" / "capsules",),
        "hide": ("--effect", "none", "--out", tmp_path / "out"),
    }[command]
    error = mistake(monkeypatch, capsys, command, *words, "--effects", path)
    assert error.startswith(f"capsbayes: {path}: expected an effect")
    assert [file.name for file in tmp_path.iterdir()] == ["mine.py"]
