"""The page of the bench: its steps, one below the other, for one tab of the browser."""

from __future__ import annotations

from pathlib import Path

from nicegui import ui

from capsbayes import __version__
from capsbayes.app.answer import AnswerStep
from capsbayes.app.channel import ChannelStep
from capsbayes.app.desk import Bench, Desk
from capsbayes.app.many import ManyStep, PopulationStep
from capsbayes.app.picture import PictureStep

_STYLE, _DROP = (Path(__file__).with_name(name) for name in ("bench.css", "drop.js"))


def bench_page(bench: Bench) -> None:
    """Build the page of a new tab, with a desk of its own."""
    ui.colors(primary="#00796b")
    ui.add_css(_STYLE.read_text(encoding="utf-8"))
    ui.run_javascript(_DROP.read_text(encoding="utf-8"))
    desk = Desk(bench)
    measured, folder = False, desk.folder

    def changed(good: bool | None = None) -> None:
        nonlocal measured, folder
        picture.overlay.put(width=channel.width)
        measured = measured if good is None else good
        before, folder = folder, desk.folder
        if before not in (None, folder):
            channel.fields["velocity"].text = ""  # it was that of an earlier capsule
        if desk.folder is None:
            missing = "Give a picture first."
        elif not measured:
            missing = "The capsule has to be measured first: see step 2."
        else:
            missing = "" if desk.stated.measured or channel.complete else "Fill in step 3 first."
        answer.allow(missing)

    with ui.column().classes("bench"):
        ui.html("<h1>capsbayes</h1>", sanitize=False)
        ui.label("Shear modulus and radius of a microcapsule, from a picture.").classes("bench-lead")
        with ui.element("div").classes("bench-columns"):
            with ui.element("div"):
                picture = PictureStep(desk, changed, lambda texts: channel.fill(texts))
            with ui.element("div"):
                channel = ChannelStep(desk, changed)
                answer = AnswerStep(desk, picture.overlay, lambda *summary: population.grown(*summary))
        answer.closer()
        ManyStep(desk, lambda: population.grown(), picture.show_measured, channel.fields)
        population = PopulationStep(desk, picture.open_again)
        ui.label(f"capsbayes {__version__}. Nothing leaves this computer.").classes("bench-foot")
