"""Steps one and two: the picture, and what is found in it."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import events, ui

from capsbayes.app.desk import Desk
from capsbayes.app.fields import FLOWS, Overlay, button, choice, notice, step, upload
from capsbayes.app.stated import (
    EXAMPLE,
    EXAMPLE_PICTURE,
    MEASUREMENT,
    OVERLAY,
    STATED,
    new_folder,
    page_words,
    safe_name,
)
from capsbayes.app.worker import WorkFailedError
from capsbayes.errors import CapsbayesError
from capsbayes.files.input_file import PICTURES

_CONTRASTS = {"": "found in the picture", "dark": "darker than the liquid", "bright": "brighter than the liquid"}
_TURNS = {"": "as it is", "90": "a quarter clockwise", "180": "upside down", "270": "a quarter anticlockwise"}
_COLOURS = {"wall": "walls", "edge": "edge", "rear": "concave rear", "predicted": "predicted outline"}


class PictureStep:
    """Upload of a picture, the overlay, and what may be stated by hand.

    The first function is called after each measurement, with True if the capsule can be identified, the second with
    what is stated of the example.
    """

    def __init__(
        self, desk: Desk, changed: Callable[[bool], object], fill: Callable[[Mapping[str, str]], object]
    ) -> None:
        self.desk, self._changed, self._fill = desk, changed, fill
        self._silent, self._flow_seen = False, ""
        self._hand: dict[str, Any] = {}  # fields of what may be stated by hand, by their names in `Stated`
        with step("1. The picture"):
            ui.label(
                "One capsule between the two walls, the flow along the rows: PNG, TIFF, JPEG or BMP. The file stays on "
                "this computer."
            )
            self._upload = upload("Drop a picture here, or choose it with +", PICTURES, self._given, "picture")
            button("Try the example", self._example)
            if (last := next(reversed(desk.bench.computed), None)) is not None and last.is_dir():
                name = last.relative_to(desk.bench.folder).as_posix()
                go_on = button(f"Go on with {name}", partial(self.open_again, last))
                go_on.on_click(go_on.delete)
            self._message = notice()
        with step("2. What is found in it"):
            nothing = ui.label("Nothing yet: give a picture first.").classes("bench-told")
            with ui.column().classes("bench-result") as self._found:
                self.overlay = Overlay(self._walls_moved, self._box_drawn)
                legend = "".join(f'<span class="{name}">{text}</span>' for name, text in _COLOURS.items())
                ui.html(f'<p class="bench-legend">{legend}</p>', sanitize=False)
                self._status = notice("bench-status")
                self._numbers = ui.html("", sanitize=False)
                with ui.expansion("Put something right by hand").classes("bench-by-hand") as self._put_right:
                    self._by_hand()
        self._found.visible = False
        nothing.bind_visibility_from(self._found, value=False)

    def _by_hand(self) -> None:
        """Fields of what may be stated by hand."""
        ui.label("Drag a wall in the picture, move it with the arrow keys, or give numbers in px from the upper left.")
        with ui.row():
            self._field("walls", "Rows of the two walls, as 12.5, 187.0")
            self._field("wall_error", "Error of either wall in px")
        with ui.row():
            self._field("crop", "Part: left, top, width, height")
            self._drawing = ui.switch("draw it in the picture", on_change=lambda: self._let_draw(erase=False))
        with ui.row():
            self._field("erase", "Wrong outline: left, top, width, height; ...")
            self._erasing = ui.switch("erase in the picture", on_change=lambda: self._let_draw(erase=True))
        with ui.row():
            labels = {"flow": "Flow", "contrast": "Capsule and walls", "rotate": "Turned"}
            for (name, label), options in zip(labels.items(), (FLOWS, _CONTRASTS, _TURNS), strict=True):
                self._hand[name] = choice(label, options, "", on_change=partial(self._state, name))
            self._hand["rotate"].props('hint="A mirrored picture needs nothing."')
            self._field("gamma", "Gamma of the camera, as 2.2")
        with ui.row():
            button("Turn the flow round", self._turn)
            button("Find everything again", self._forget)
        ui.label("Picture of the empty channel, if there is one:")
        upload("Empty channel", PICTURES, self._background_given, "background")

    def _field(self, name: str, label: str) -> None:
        field = ui.input(label, on_change=partial(self._state, name))
        self._hand[name] = field.props("dense outlined debounce=600")

    async def _given(self, event: events.UploadEventArguments) -> None:
        name = safe_name(event.file.name, PICTURES)
        if name is None:
            self._tell(f"Expected a picture ({', '.join(PICTURES)}).", bad=True)
        else:
            folder = new_folder(self.desk.bench.folder, name.rpartition(".")[0])
            await event.file.save(folder / name)
            await self._begin(folder, name)
        self._upload.reset()  # earlier, it would break off the request that brings the file

    async def _example(self) -> None:
        folder = new_folder(self.desk.bench.folder, EXAMPLE_PICTURE.stem)
        shutil.copy(EXAMPLE_PICTURE, folder)
        await self._begin(folder, EXAMPLE_PICTURE.name)
        self._fill(EXAMPLE)

    async def _begin(self, folder: Path, name: str) -> None:
        """Show a picture that is kept in a folder of its own, and measure it."""
        self.desk.folder, self.desk.stated = folder, self.desk.stated.of(picture=name)
        try:
            picture = await self._seen()
        except WorkFailedError as error:
            self.desk.folder, self._found.visible = None, False
            self._tell(str(error), bad=True)
            shutil.rmtree(folder)
            self._changed(False)
            return
        await self._show(picture, f"{name}: {picture['columns']} x {picture['rows']} pixels.")

    async def open_again(self, folder: Path) -> None:
        """Show a capsule of an earlier time as it was stated, or as it was measured in a film or in an event."""
        if not (folder / STATED).is_file():
            await self.show_measured(folder)
            return
        try:
            self.desk.take_up(folder)
            known, stated = self.desk.experiment, self.desk.stated
            speeds = {"velocity": stated.velocity, "flow_rate": stated.flow_rate}
            self._changed(False)  # and the form states what it held before
            self._fill({**known, **known.get("camera", {}), **speeds})
            picture = await self._seen()
        except CapsbayesError as error:
            self._tell(page_words(error), bad=True)
            return
        await self._show(picture, f"{stated.picture} was opened again.")

    async def show_measured(self, folder: Path) -> None:
        """Show a capsule that was measured in a film or in an event, by the overlay that is kept in its folder."""
        stated = self.desk.stated.of(measured=MEASUREMENT)
        if (computed := self.desk.bench.computed.get(folder)) is not None:
            stated = replace(computed.asked[0], velocity=stated.velocity, flow_rate=stated.flow_rate)
        self.desk.folder, self.desk.stated = folder, stated
        await self._show(await self._seen(), f"{folder.name} of {folder.parent.name} was chosen.")

    async def _seen(self) -> dict[str, Any]:
        """Return the picture, turned as it is stated, or the overlay of what was measured."""
        stated = self.desk.stated
        seen: dict[str, Any] = await self.desk.measured("shown", name=stated.picture or OVERLAY, rotate=stated.rotate)
        return seen

    async def _show(self, picture: dict[str, Any], words: str) -> None:
        """Show another picture, and in the fields what is stated of it, without measuring for each; measure it."""
        self.desk.bench.identifying.start()
        self._tell(words)
        self._found.visible = True
        self._put_right.visible = not self.desk.stated.measured
        self._show_stated()
        self.overlay.show(picture)
        await self.measure()

    def _show_stated(self) -> None:
        self._silent = True
        for name, field in self._hand.items():
            field.value = getattr(self.desk.stated, name)
        self._silent = False

    def _tell(self, text: str, *, bad: bool = False) -> None:
        self._message.text = text
        self._message.classes(replace="bench-message" if bad else "bench-told")

    async def _background_given(self, event: events.UploadEventArguments) -> None:
        name = safe_name(event.file.name, PICTURES)
        if name is None or self.desk.folder is None:
            return
        await event.file.save(self.desk.folder / f"empty-{name}")
        self.desk.stated.background = f"empty-{name}"
        await self.measure()

    async def measure(self) -> None:
        """Measure the picture as it is stated now, and draw what is found."""
        if self.desk.folder is None:
            return
        if self.desk.stated.measured:
            self._status.text, self._numbers.content = "The capsule was measured, as its overlay shows.", ""
            self._changed(True)
            return
        self.desk.keep()
        try:
            seen = await self.desk.measured("measured", stated=self.desk.stated)
        except WorkFailedError as error:
            self._status.text = str(error)
            self._changed(False)
            return
        self._flow_seen = {1: "right", -1: "left"}.get(seen["flow"], "")
        self.overlay.draw(seen, by_hand=bool(self.desk.stated.walls))
        flow = f", the flow is to the {self._flow_seen}" if self._flow_seen else ""
        self._status.text = f"The capsule was measured{flow}." if seen["ok"] else f"{seen['status']}{flow}"
        rows = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in seen["rows"])
        head = "<tr><th></th><th>pixels</th><th>over ℓ</th></tr>"
        self._numbers.content = f"<table class='bench-table'>{head}{rows}</table>" if rows else ""
        self._changed(seen["ok"])

    async def _state(self, name: str, event: events.ValueChangeEventArguments) -> None:
        text = (event.value or "").strip()
        if self._silent or self.desk.folder is None or getattr(self.desk.stated, name) == text:
            return
        setattr(self.desk.stated, name, text)
        if name == "walls" and not text:
            self.desk.stated.wall_error = ""
        if name == "rotate":
            self.overlay.show(await self._seen())
        await self.measure()

    async def _walls_moved(self, rows: list[float]) -> None:
        upper, lower = [f"{row:.1f}" for row in rows[:2]], [f"{row:.1f}" for row in rows[2:]]
        level = upper[0] == upper[1] and lower[0] == lower[1]
        text = f"{upper[0]}, {lower[0]}" if level else f"{' '.join(upper)}, {' '.join(lower)}"
        self._hand["walls"].value = text  # which states it, and measures again

    async def _box_drawn(self, numbers: list[float]) -> None:
        text = ", ".join(f"{number:g}" for number in numbers)
        if self._erasing.value:
            self._hand["erase"].value = "; ".join(filter(None, (self._hand["erase"].value, text)))
        else:
            self._drawing.value = False
            self._hand["crop"].value = text

    def _let_draw(self, *, erase: bool) -> None:
        """Let a box be drawn for one of the two switches, and turn the other off."""
        switch, other = (self._erasing, self._drawing) if erase else (self._drawing, self._erasing)
        if switch.value:
            other.value = False
        self.overlay.put(drawing=self._drawing.value or self._erasing.value)

    def _turn(self) -> None:
        now = self.desk.stated.flow or self._flow_seen or "left"
        self._hand["flow"].value = "left" if now == "right" else "right"

    async def _forget(self) -> None:
        stated = self.desk.stated
        self.desk.stated = stated.of(stated.picture, background=stated.background)
        self._show_stated()
        if stated.rotate:
            self.overlay.show(await self._seen())
        await self.measure()
