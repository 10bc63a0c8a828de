"""Several files on the page: each has a velocity of its own, or all have the flow rate of step 3."""

import asyncio
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("nicegui")
from nicegui import ui
from nicegui.testing import user_simulation

from capsbayes.app.desk import Bench, Desk
from capsbayes.app.steps.many import ManyStep

PICTURE = Path("examples/pictures/capsule.png").read_bytes()


def test_one_velocity_for_several_pictures_is_refused_in_the_words_of_the_page(tmp_path, monkeypatch):
    """Step 3 holds the velocity of one capsule: no file is measured with it."""
    bench = Bench(tmp_path)
    desk, made = Desk(bench, experiment={"cross_section": "square", "half_width": "25 um", "viscosity": "0.8 Pa s"}), []
    desk.stated.velocity = "4.86 +/- 0.04 mm/s"

    async def shown(task, **how):
        return {"rows": 160, "columns": 220, "src": "", "count": 1}

    async def chosen(folder):
        raise AssertionError(folder)

    async def told():
        async with user_simulation(lambda: made.append(ManyStep(desk, lambda: None, chosen))) as user:
            await user.open("/")
            upload = next(one for one in user.find(ui.upload).elements)
            files = [ui.upload.SmallFileUpload(name, "", PICTURE) for name in ("a.png", "b.png")]
            await upload.handle_uploads(files)
            while len(made[-1]._files) < 2:
                await asyncio.sleep(0.05)
            user.find("Measure them all").click()
            while any(file.status.text == "waits" for file in made[-1]._files):
                await asyncio.sleep(0.05)
            return {file.status.text for file in made[-1]._files}

    monkeypatch.setattr(bench.measuring, "run", shown)
    said = asyncio.run(asyncio.wait_for(told(), 60))
    expected = "Its velocity is missing: that of step 3 is of one capsule."
    assert said == {f"{expected} Type the file's own, or the flow rate in step 3."}
    assert not list(tmp_path.glob("**/measurement.toml"))


def test_what_a_command_refuses_is_told_without_its_options(tmp_path, monkeypatch):
    async def printed_by(*_, **__):
        return 2, "capsbayes: --frame-rate: expected a rate, got nothing; give --frame-rate"

    monkeypatch.setattr("capsbayes.app.steps.many.printed_by", printed_by)
    told = SimpleNamespace(text="", classes=lambda **_: None)
    one = SimpleNamespace(folder=tmp_path, name="film.avi", status=told, waiting=True)
    step = SimpleNamespace(_progress=None)
    assert not asyncio.run(ManyStep._one(step, one, ["capsbayes", "measure"]))
    assert told.text == "frame rate: expected a rate, got nothing; give frame rate"
