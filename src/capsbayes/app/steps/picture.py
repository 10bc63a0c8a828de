"""Steps one and two: the picture, and what is found in it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from nicegui import events, ui

from capsbayes.app.desk import MOST_BYTES, Desk
from capsbayes.app.overlay import Overlay
from capsbayes.app.stated import EXPERIMENT, MEASUREMENT, OVERLAY, new_folder, safe_name
from capsbayes.app.worker import WorkFailedError
from capsbayes.files.input_file import PICTURES

_FLOWS = {"": "found from the shape", "right": "to the right", "left": "to the left"}
_CONTRASTS = {"": "found in the picture", "dark": "darker than the liquid", "bright": "brighter than the liquid"}
_COLOURS = (("wall", "walls"), ("edge", "edge"), ("rear", "concave rear"), ("predicted", "predicted outline"))


class PictureStep:
    """Upload of a picture, the overlay, and what may be stated by hand.

    Parameters
    ----------
    desk : Desk
    changed : function
        Called after each measurement, with True if the capsule can be identified.
    """

    def __init__(self, desk: Desk, changed: Callable[[bool], object]) -> None:
        self.desk, self._changed = desk, changed
        self._silent = False
        self._drawing: ui.switch
        self._erasing: ui.switch
        with ui.card().classes("bench-step"):
            ui.html("<h2>1. The picture</h2>", sanitize=False)
            ui.label(
                "One capsule between the two walls, the flow along the rows: PNG, TIFF or JPEG. The file stays on this "
                "computer."
            )
            upload = ui.upload(
                label="Drop a picture here, or choose it with +",
                auto_upload=True,
                max_file_size=MOST_BYTES,
                on_upload=self._given,
                on_rejected=lambda: ui.notify("This file is larger than 512 MB.", type="negative"),
            )
            upload.props(f'accept="{",".join(PICTURES)}" flat bordered').classes("bench-upload").mark("picture")
            self._upload = upload
            self._message = ui.label().classes("bench-told").props('role="status"')
        with ui.card().classes("bench-step") as self._card:
            ui.html("<h2>2. What is found in it</h2>", sanitize=False)
            self.overlay = Overlay(self._walls_moved, self._box_drawn)
            legend = "".join(f'<span class="{name}">{text}</span>' for name, text in _COLOURS)
            ui.html(f'<p class="bench-legend">{legend}</p>', sanitize=False)
            self._status = ui.label().classes("bench-status").props('role="status"')
            self._numbers = ui.html("", sanitize=False)
            self._by_hand()
        self._card.visible = False

    def _by_hand(self) -> None:
        """Fields of what may be stated by hand."""
        with ui.expansion("Put something right by hand").classes("bench-by-hand") as self._put_right:
            ui.label(
                "Drag a wall in the picture, move it with the arrow keys, or give numbers in px from the upper left."
            )
            with ui.row():
                self._walls = self._field("Rows of the two walls, as 12.5, 187.0", "walls")
                self._wall_error = self._field("Error of either wall in px", "wall_error")
            with ui.row():
                self._crop = self._field("Part: left, top, width, height", "crop")
                self._drawing = ui.switch("draw it in the picture", on_change=lambda: self._let_draw(self._drawing))
            with ui.row():
                self._erase = self._field("Wrong outline: left, top, width, height; ...", "erase")
                self._erasing = ui.switch("erase in the picture", on_change=lambda: self._let_draw(self._erasing))
            with ui.row():
                self._flow = self._choice("Flow", "flow", _FLOWS)
                self._contrast = self._choice("Capsule and walls", "contrast", _CONTRASTS)
            with ui.row():
                ui.button("Turn the flow round", on_click=self._turn).props("outline no-caps")
                ui.button("Find everything again", on_click=self._forget).props("outline no-caps")
            ui.label("Picture of the empty channel, if there is one:")
            background = ui.upload(label="Empty channel", auto_upload=True, on_upload=self._background_given)
            background.props(f'accept="{",".join(PICTURES)}" flat bordered').classes("bench-upload").mark("background")

    def _field(self, label: str, name: str) -> Any:
        field = ui.input(label).props("dense outlined debounce=600")
        field.on_value_change(lambda event: self._state(name, event.value or ""))
        return field

    def _choice(self, label: str, name: str, options: dict[str, str]) -> Any:
        choice = ui.select(options, label=label, value="").props("dense outlined").classes("bench-choice")
        choice.on_value_change(lambda event: self._state(name, event.value or ""))
        return choice

    async def _given(self, event: events.UploadEventArguments) -> None:
        await self._taken(event)
        self._upload.reset()  # earlier, it would break off the request that brings the file

    async def _taken(self, event: events.UploadEventArguments) -> None:
        """Keep a picture in a folder of its own, show it, and measure it."""
        name = safe_name(event.file.name, PICTURES)
        if name is None:
            self._tell(f"Expected a picture ({', '.join(PICTURES)}).", bad=True)
            return
        folder = new_folder(self.desk.bench.folder, name.rpartition(".")[0])
        await event.file.save(folder / name)
        self.desk.folder, self.desk.stated = folder, self.desk.stated.of(picture=name)
        try:
            picture = await self.desk.measured("shown", name=name)
            self.desk.bench.identifying.start()
        except WorkFailedError as error:
            self.desk.folder, self._card.visible = None, False
            self._tell(str(error), bad=True)
            (folder / name).unlink(missing_ok=True)
            folder.rmdir()
            self._changed(False)
            return
        self._tell(f"{name}: {picture['columns']} x {picture['rows']} pixels.")
        self._show_stated()
        self._card.visible = True
        self.overlay.show(picture)
        await self.measure()

    async def show_measured(self, folder: Path) -> None:
        """Show a capsule that was measured in a film or in an event, by the overlay that is kept in its folder."""
        self.desk.folder, self.desk.stated = folder, self.desk.stated.of(measured=MEASUREMENT)
        self._show_stated()
        self._tell(f"{folder.name} of {folder.parent.name} was chosen.")
        self._card.visible = True
        self.overlay.show(await self.desk.measured("shown", name=OVERLAY))
        self._status.text, self._numbers.content = "The capsule was measured, as its overlay shows.", ""
        self._changed(True)

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
        if self.desk.folder is None or self.desk.stated.measured:
            return
        experiment = self.desk.folder / EXPERIMENT
        if not experiment.exists() and self.desk.experiment:
            self.desk.keep_experiment()
        try:
            found = await self.desk.measured("measured", stated=self.desk.stated)
        except WorkFailedError as error:
            self._status.text = str(error)
            self._changed(False)
            return
        self._found = found
        lines = {name: found[name] for name in ("walls", "outline", "rear", "crop", "erased")}
        self.overlay.draw(**lines, by_hand=bool(self.desk.stated.walls))
        flow = {1: ", the flow is to the right", -1: ", the flow is to the left"}.get(found["flow"], "")
        self._status.text = f"{found['status']}{flow}" if not found["ok"] else f"The capsule was measured{flow}."
        rows = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in found["rows"])
        head = "<tr><th></th><th>pixels</th><th>over ℓ</th></tr>"
        self._numbers.content = f"<table class='bench-table'>{head}{rows}</table>" if rows else ""
        self._changed(found["ok"])

    async def _state(self, name: str, text: str) -> None:
        if self._silent or self.desk.folder is None or getattr(self.desk.stated, name) == text.strip():
            return
        setattr(self.desk.stated, name, text.strip())
        if name == "walls" and not text.strip():
            self.desk.stated.wall_error = ""
        await self.measure()

    async def _walls_moved(self, rows: list[float]) -> None:
        upper, lower = [f"{row:.1f}" for row in rows[:2]], [f"{row:.1f}" for row in rows[2:]]
        level = upper[0] == upper[1] and lower[0] == lower[1]
        text = f"{upper[0]}, {lower[0]}" if level else f"{' '.join(upper)}, {' '.join(lower)}"
        self._walls.value = text  # which states it, and measures again

    async def _box_drawn(self, numbers: list[float]) -> None:
        text = ", ".join(f"{number:g}" for number in numbers)
        if self._erasing.value:
            self._erase.value = "; ".join(filter(None, (self._erase.value, text)))
        else:
            self._drawing.value = False
            self._crop.value = text

    def _let_draw(self, switch: Any) -> None:
        """Let a box be drawn for one of the two switches, and turn the other off."""
        other = self._drawing if switch is self._erasing else self._erasing
        if switch.value:
            other.value = False
        self.overlay.let_draw(self._drawing.value or self._erasing.value)

    def _turn(self) -> None:
        now = self.desk.stated.flow or {1: "right", -1: "left"}.get(self._found["flow"], "left")
        self._flow.value = "left" if now == "right" else "right"

    async def _forget(self) -> None:
        stated = self.desk.stated
        self.desk.stated = stated.of(stated.picture, background=stated.background, membrane=stated.membrane)
        self._show_stated()
        await self.measure()

    def _show_stated(self) -> None:
        """Show in the fields what is stated, without measuring for each."""
        self._silent = True
        self._put_right.visible = not self.desk.stated.measured
        for name in ("walls", "wall_error", "crop", "erase", "flow", "contrast"):
            getattr(self, f"_{name}").value = getattr(self.desk.stated, name)
        self._silent = False
