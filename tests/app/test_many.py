"""Several files on the page, each with a velocity of its own or the flow rate of step 3; and all capsules together."""

import asyncio
import zipfile
from pathlib import Path

import pytest

pytest.importorskip("nicegui", reason="the extra app is not installed")

from nicegui import ui
from nicegui.testing import user_simulation

from capsbayes.app import many, measuring
from capsbayes.app.channel import ChannelStep
from capsbayes.app.desk import Bench, Desk

PICTURE = Path("examples/pictures/capsule.png").read_bytes()
CHANNEL = {"cross_section": "square", "half_width": "25 um", "viscosity": "0.8 Pa s"}
SUMMARY = {"surface_shear_modulus": (0.05, 0.002), "capsule_radius": (23.5e-6, 0.2e-6)}


def statuses(desk, monkeypatch):
    """What is said of two pictures that are given at once, and measured."""
    made = []

    async def shown(task, **how):
        return {"rows": 160, "columns": 220, "src": "", "count": 1, "stated": {}}

    async def chosen(folder):
        raise AssertionError(folder)

    def page():
        made.append(many.ManyStep(desk, lambda: None, chosen, {}))

    async def pressed():
        async with user_simulation(page) as user:
            await user.open("/")
            upload = next(iter(user.find(marker="many").elements))
            await upload.handle_uploads([ui.upload.SmallFileUpload(f"{x}.png", "", PICTURE + x.encode()) for x in "ab"])
            while len(made[-1]._files) < 2:
                await asyncio.sleep(0.05)
            user.find("Measure them all").click()
            while any(file.status.text in ("waits", "is measured") for file in made[-1]._files):
                await asyncio.sleep(0.05)
            return {file.status.text for file in made[-1]._files}

    monkeypatch.setattr(desk.bench.measuring, "run", shown)
    return asyncio.run(asyncio.wait_for(pressed(), 60))


def test_one_velocity_for_several_pictures_is_refused_in_the_words_of_the_page(tmp_path, monkeypatch):
    """Step 3 holds the velocity of one capsule: no file is measured with it."""
    desk = Desk(Bench(tmp_path), experiment=CHANNEL)
    desk.stated.velocity = "4.86 +/- 0.04 mm/s"
    expected = "Its velocity is missing: that of step 3 is of one capsule."
    assert statuses(desk, monkeypatch) == {f"{expected} Type the file's own, or the flow rate in step 3."}
    assert not list(tmp_path.glob("**/measurement.toml"))


STATED = {"half_width": "25 um", "pixel_size": "0.68 um", "flow_rate": "0.5625 uL/min"}
TYPED = {"half_width": "25.1 +/- 0.2 um", "pixel_size": "0,70 +/- 0.01 um", "velocity": "5 mm/s"}
DIFFER = "Size of a pixel of an .rtdc file: the file states 0.68 µm, the field 0.70 +/- 0.01 µm."


@pytest.mark.parametrize(("typed", "told"), [({}, ""), (TYPED, DIFFER)], ids=["empty fields", "typed"])
def test_what_an_rtdc_file_states_fills_empty_fields_and_overwrites_nothing(typed, told, tmp_path, monkeypatch):
    desk, made = Desk(Bench(tmp_path)), []

    async def shown(task, **how):
        return {"rows": 80, "columns": 250, "src": "", "count": 4, "stated": STATED}

    def page():
        made.append(ChannelStep(desk, lambda: None))
        made.append(many.ManyStep(desk, lambda: None, lambda folder: None, made[0].fields))

    async def given():
        async with user_simulation(page) as user:
            await user.open("/")
            channel, files = made
            for name, text in typed.items():
                field = files._pixel if name == "pixel_size" else channel.fields[name]
                field._value.value = text
            upload = next(iter(user.find(marker="many").elements))
            await upload.handle_uploads([ui.upload.SmallFileUpload("cells.rtdc", "", b"events")])
            while not files._files:
                await asyncio.sleep(0.05)
            seen = {name: channel.fields[name].text for name in ("half_width", "flow_rate", "velocity")}
            return seen | {"pixel_size": files._pixel.text}, files._files[0].differs.text

    monkeypatch.setattr(desk.bench.measuring, "run", shown)
    found, words = asyncio.run(asyncio.wait_for(given(), 60))
    empty = {"velocity": ""} | STATED
    kept = {"flow_rate": ""} | {name: text.replace(",", ".") for name, text in typed.items()}
    assert found == (kept if typed else empty)
    assert words == told
    assert desk.experiment["half_width"] == found["half_width"]


def test_an_rtdc_file_tells_its_channel_pixel_and_flow_rate():
    assert measuring.shown("examples/pictures", "cells.rtdc")["stated"] == STATED


def test_what_a_command_refuses_is_told_without_its_options(tmp_path, monkeypatch):
    async def printed_by(*_, **__):
        return 2, "capsbayes: --frame-rate: expected a rate, got nothing; give --frame-rate"

    monkeypatch.setattr(many, "printed_by", printed_by)
    desk = Desk(Bench(tmp_path), experiment=CHANNEL)
    desk.stated.flow_rate = "0.56 uL/min"
    assert statuses(desk, monkeypatch) == {"frame rate: expected a rate, got nothing; give frame rate"}


@pytest.mark.parametrize("place", ["capsule", "film/capsule-1", "cells/event-0"])
def test_the_next_flow_rate_is_computed_for_the_last_capsule_wherever_it_is_kept(place, tmp_path, monkeypatch):
    ran = []

    async def noted(words, folder, watch):
        ran.append((words, folder))
        return 0, "printed"

    monkeypatch.setattr(many, "printed_by", noted)
    kept = tmp_path / place / "measurement.toml"
    kept.parent.mkdir(parents=True)
    kept.touch()

    async def pressed():
        desk = Desk(Bench(tmp_path), folder=kept.parent)
        async with user_simulation(lambda: many.PopulationStep(desk, print).grown(SUMMARY)) as user:
            await user.open("/")
            user.find("At which flow rate next?").click()
            await user.should_see("printed")

    asyncio.run(pressed())
    ((words, folder),) = ran
    assert words[:2] == ["sensitivity", "flow"]
    assert folder / words[words.index("--like") + 1] == kept
    assert words[words.index("--radius") + 1] == "23.5 +/- 0.2 um"
    assert words[words.index("--shear-modulus") + 1] == "50 +/- 2 mN/m"


def test_a_file_of_capsules_is_loaded_behind_a_bar_with_words(tmp_path, monkeypatch):
    bench, go_on = Bench(tmp_path), asyncio.Event()

    async def run(task, **how):
        await go_on.wait()
        with zipfile.ZipFile(how["name"]):
            return 2, 0

    monkeypatch.setattr(bench.measuring, "run", run)

    async def given():
        async with user_simulation(lambda: many.ManyStep(Desk(bench), lambda: None, print, {})) as user:
            await user.open("/")
            upload = next(iter(user.find(marker="many").elements))
            with zipfile.ZipFile(tmp_path / "kept.zip", "w") as kept:
                kept.writestr("capsule/measurement.toml", "")
            content = (tmp_path / "kept.zip").read_bytes()
            handled = asyncio.create_task(upload.handle_uploads([ui.upload.SmallFileUpload("kept.zip", "", content)]))
            await user.should_see("kept.zip is loaded")
            go_on.set()
            await handled
            await user.should_see("kept.zip: 2 folders loaded. Step 7 lists the capsules.")
            await user.should_not_see("kept.zip is loaded")

    asyncio.run(asyncio.wait_for(given(), 60))
