"""The form of channel and liquid: what a file states is filled in, and saved as the same experiment."""

import asyncio
from pathlib import Path

import pytest

pytest.importorskip("nicegui", reason="the extra app is not installed")

from nicegui import ui
from nicegui.testing import user_simulation

from capsbayes.app.channel import ChannelStep
from capsbayes.app.desk import Bench, Desk
from capsbayes.experiment import Experiment
from capsbayes.quantity import Quantity

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*/experiment.toml"))
EVERYTHING = """
cross_section = "circular"
half_width = "24.0 .. 26.0 um"
viscosity = "850 +/- 20 mPa s"
frame_rate = "2000 Hz"
exposure = "20 us"
density = "1.26 g/cm^3"
membrane_thickness = "0.6 +/- 0.1um"
[camera]
pixel_aspect = "1.020 +/- 0.005"
taper = "0.000 +/- 0.002"
"""
TENSION = 'cross_section = "square"\nhalf_width = "25 um"\nviscous_tension = "28 +/- 1 mN/m"\n'


def filled(folder, text, *, velocity="", rate=""):
    """Give the form a file, then a velocity or flow rate, without a browser; return desk, step, and what it says."""
    desk, made = Desk(Bench(folder), folder=folder), []

    def page():
        made.append(ChannelStep(desk, lambda: None))

    async def given():
        async with user_simulation(page) as user, asyncio.timeout(60):
            await user.open("/")
            upload = user.find(ui.upload).elements.pop()
            await upload.handle_uploads([ui.upload.SmallFileUpload("experiment.toml", "", text.encode())])
            (said,) = (one for one in user.find(ui.label).elements if one.props.get("role") == "status" and one.visible)
            while not (said.text or desk.experiment):
                await asyncio.sleep(0.01)
            if velocity:
                user.find("Velocity of the capsule").type(velocity)
            if rate:
                user.find("Or flow rate in the channel").type(rate)
            return said.text

    said = asyncio.run(given())
    return desk, made[-1], said


def same(one, other):
    names = ("half_width", "viscosity", "viscous_tension", "frame_rate", "exposure", "density", "membrane_thickness")
    assert one.cross_section == other.cross_section
    for name in names:
        before, after = getattr(one, name), getattr(other, name)
        assert (before is None) == (after is None), name
        assert before is None or str(before) == str(after), name
    assert (one.camera and one.camera.described()) == (other.camera and other.camera.described())


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.parent.name)
def test_the_experiments_of_the_examples_fill_the_form_and_are_saved_as_they_were(path, tmp_path):
    _, step, said = filled(tmp_path, path.read_text(encoding="utf-8"))
    same(Experiment.read(tmp_path / "experiment.toml"), Experiment.read(path))
    assert (step.complete, said) == (False, "The velocity of the capsule is missing, or the flow rate.")


@pytest.mark.parametrize("text", [EVERYTHING, TENSION], ids=["everything", "viscous tension"])
def test_there_is_a_field_for_whatever_an_experiment_states(text, tmp_path):
    (tmp_path / "given.toml").write_text(text)
    filled(tmp_path, text)
    same(Experiment.read(tmp_path / "experiment.toml"), Experiment.read(tmp_path / "given.toml"))


def test_a_velocity_is_needed_with_a_viscosity_and_left_out_with_the_product_of_both(tmp_path):
    desk, step, _ = filled(tmp_path, EVERYTHING, velocity="6.2")
    assert (desk.stated.velocity, step.complete) == ("6.2 mm/s", True)
    for typed in ("6,2 +/- 0,062 mm/s", "6.2 +/- 1% mm/s", "6.2 +/- 1%", "0.62 cm/s +/- 62 um/s"):
        desk, _, _ = filled(tmp_path, EVERYTHING, velocity=typed)
        assert Quantity.of(desk.stated.velocity).parameters == pytest.approx((6.2e-3, 6.2e-5))
    desk, step, _ = filled(tmp_path, TENSION, velocity="6.2")
    assert (desk.stated.velocity, step.complete) == ("", True)


def test_a_flow_rate_makes_a_velocity_unnecessary_and_an_old_velocity_is_forgotten(tmp_path):
    desk, step, _ = filled(tmp_path, EVERYTHING, rate="0.56")
    assert (desk.stated.velocity, desk.stated.flow_rate, step.complete) == ("", "0.56 uL/min", True)
    desk, step, _ = filled(tmp_path, EVERYTHING, velocity="6.2")
    step.fields["velocity"].text = ""
    assert (desk.stated.velocity, step.complete) == ("", False)


def test_a_key_that_no_experiment_has_is_refused_by_its_name(tmp_path):
    _, step, said = filled(tmp_path, TENSION + 'colour = "red"\n')
    assert (step.complete, said) == (False, "Expected the file of an experiment: the form has no field for colour")
    assert not (tmp_path / "experiment.toml").exists()


@pytest.mark.parametrize(("text", "width"), [("25 +/- 0.2 um", 50.0), ("0.024 .. 0.026 mm", 50.0), ("wide", 0.0)])
def test_the_width_of_the_channel_is_known_where_the_half_width_can_be_read(text, width, tmp_path):
    _, step, _ = filled(tmp_path, f'cross_section = "square"\nhalf_width = "{text}"\nviscosity = "1 Pa s"\n')
    assert step.width == pytest.approx(width)


def test_a_file_in_si_is_shown_in_the_units_of_the_form(tmp_path):
    text = 'cross_section = "square"\nhalf_width = "2.5e-05 +/- 2e-07 m"\nviscosity = "8e-1 Pa s"\n'
    desk, _, _ = filled(tmp_path, text)
    assert (desk.experiment["half_width"], desk.experiment["viscosity"]) == ("25 +/- 0.2 um", "0.8 Pa s")
