"""The options of the section and of the shape at rest."""

from functools import partial

import pytest
from analytic_simulator import AnalyticSimulator
from command_line import mistake, run

import capsbayes.physics.simulator
from capsbayes.physics.simulator import Simulator
from capsbayes.physics.stokes import WallDiscretisation

OPTIONS = ("--corner-radius", "0.1", "--rest-aspect", "1.05")


def test_simulate_states_the_section_it_was_given(monkeypatch, capsys):
    coarse = partial(Simulator, walls=WallDiscretisation(spacing=0.16, far_spacing=0.3, end=2.5))
    monkeypatch.setattr(capsbayes.physics.simulator, "Simulator", coarse)
    case = ("--ca", "0.05", "--size-ratio", "0.75", "--refinement", "4", "--pre-inflation", "0.1")
    status, out, _ = run(monkeypatch, capsys, "simulate", *case, *OPTIONS)
    assert status == 0
    title = " ".join(out.partition("Done.")[0].split())
    assert title.endswith("pre inflation 0.1, corner radius 0.1, rest aspect 1.05")


def test_build_hands_the_section_to_the_simulator(monkeypatch, capsys, tmp_path):
    given = {}

    def simulator(**settings):
        given.update(settings)
        return AnalyticSimulator()

    monkeypatch.setattr(capsbayes.physics.simulator, "Simulator", simulator)
    (tmp_path / "cases.csv").write_text("capillary_number,size_ratio\n0.05,0.9\n")
    case = ("--cases", str(tmp_path / "cases.csv"), "--out", str(tmp_path / "shapes.nc"))
    status, _, _ = run(monkeypatch, capsys, "build", *case, "--scheduler", "synchronous", *OPTIONS)
    assert status == 0
    assert (given["cross_section"], given["corner_radius"], given["section_aspect"]) == ("square", 0.1, 1.0)
    assert given["rest_aspect"] == 1.05


@pytest.mark.parametrize(
    "command", [("simulate", "--ca", "0.05", "--size-ratio", "0.8"), ("build", "--grid", "default")]
)
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--cross-section", "oval"), "cross_section: expected one of square, rectangular, circular, got 'oval'"),
        (("--cross-section", "circular", "--section-aspect", "1.1"), "section_aspect: expected 1 for a circular"),
        (
            ("--cross-section", "rectangular", "--section-aspect", "3"),
            "section_aspect: expected a number from 0.5 to 2",
        ),
        (("--corner-radius", "1.5"), "cross_section: corner_radius: expected a number between 0 and 1, got 1.5"),
        (("--rest-aspect", "3"), "rest_aspect: expected a number from 0.5 to 2, got 3.0"),
    ],
)
def test_impossible_sections_are_one_line_and_status_2(monkeypatch, capsys, tmp_path, command, options, message):
    monkeypatch.chdir(tmp_path)
    out = ("--out", "shapes.nc") if command[0] == "build" else ()
    assert message in mistake(monkeypatch, capsys, *command, *out, *options)
    assert list(tmp_path.iterdir()) == []
