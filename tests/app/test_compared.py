"""Capsules side by side: what the table says of saved and of identified ones, and how the page shows it."""

import pytest

pytest.importorskip("nicegui", reason="the extra app is not installed")

import asyncio
import shutil

from nicegui import ui
from nicegui.testing import user_simulation
from printed import plain
from results import posterior

from capsbayes.app import identifying, many
from capsbayes.app.desk import Bench, Desk
from capsbayes.app.stated import EXAMPLE, EXAMPLE_PICTURE, Stated
from capsbayes.app.worker import WorkFailedError
from capsbayes.errors import CapsbayesError

CHANNEL = {"cross_section": "square", "half_width": EXAMPLE["half_width"], "viscosity": EXAMPLE["viscosity"]}


@pytest.fixture
def bench(tmp_path):
    """A bench with two capsules that were saved, and one that was not identified."""
    for name in ("one", "two", "waiting"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "measurement.toml").touch()
    for name in ("one", "two"):
        posterior().write(tmp_path / name / "posterior.nc")
        (tmp_path / name / "report.html").touch()
    return Bench(tmp_path)


def test_saved_and_identified_capsules_are_compared(bench):
    folder = bench.folder / "example"
    folder.mkdir()
    shutil.copy(EXAMPLE_PICTURE, folder)
    desk = Desk(bench, Stated("example.png", velocity=EXAMPLE["velocity"]), folder, CHANNEL)
    desk.keep()
    asked = desk.stated.asked(folder)
    capsules = {"one": (str(bench.folder / "one"), None), "example": (str(folder), asked)}
    figure, table = identifying.compared(capsules)
    assert figure.count("<img") == 1
    assert "densities of G_s of one, example" in figure
    text = plain(table)
    for words in ("one", "example", "≠ µ, viscosity of the suspending liquid", "0.850 ± 0.020 Pa s", "is neo-Hookean"):
        assert words in text
    desk.experiment["viscosity"] = "0.9 +/- 0.02 Pa s"
    desk.keep()
    with pytest.raises(CapsbayesError, match="example: expected what it was identified from, got other numbers"):
        identifying.compared(capsules)


def test_two_that_are_ticked_are_compared_behind_a_bar_and_one_without_a_result_cannot_be(bench, monkeypatch):
    asked, go_on = [], asyncio.Event()

    async def run(task, **how):
        asked.append((task, how["capsules"]))
        await go_on.wait()
        if len(asked) > 1:
            raise WorkFailedError("two: expected a posterior, got another file")
        return "<p>the densities</p>", "<table><td>the table</td></table>"

    monkeypatch.setattr(bench.identifying, "run", run)
    monkeypatch.setattr(bench.identifying, "start", lambda: None)
    made = []

    async def pressed():
        async with user_simulation(lambda: made.append(many.PopulationStep(Desk(bench), print))) as user:
            await user.open("/")
            (step,) = made
            boxes = list(user.find(kind=ui.checkbox).elements)
            assert sorted(box.text for box in boxes) == ["one", "two"]
            boxes[0].value = True
            assert not step._compare.enabled
            boxes[1].value = True
            assert step._compare.enabled
            step.grown()  # as another capsule was saved: the ticks stay
            assert all(box.value for box in user.find(kind=ui.checkbox).elements)
            user.find(kind=ui.button, content="Compare").click()
            await user.should_see("2 capsules are compared")
            go_on.set()
            await user.should_see(kind=ui.html, content="the table")
            await user.should_not_see("2 capsules are compared")
            user.find(kind=ui.button, content="Compare").click()
            await user.should_see("two: expected a posterior, got another file")

    asyncio.run(asyncio.wait_for(pressed(), 60))
    places = {name: (str(bench.folder / name), None) for name in ("one", "two")}
    assert asked == [("compared", places)] * 2
