"""The step of many capsules: films, .rtdc files, and several pictures at once, each measured by its command."""

from __future__ import annotations

import asyncio
import html
import shlex
import shutil
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from nicegui import events, ui

from capsbayes.app.bar import Progress
from capsbayes.app.command import printed_by
from capsbayes.app.desk import MOST_BYTES, Desk
from capsbayes.app.fields import QuantityField
from capsbayes.app.stated import EVENTS, KINDS, OVERLAY, OfMany, new_folder, safe_name, said
from capsbayes.app.worker import WorkFailedError

_FLOWS = {"": "found from the shape", "right": "to the right", "left": "to the left"}


@dataclass
class _File:
    """A file that was given: where it is kept, its velocity unless it is a film, and its row on the page."""

    folder: Path
    name: str
    velocity: QuantityField | None
    status: ui.label
    row: ui.element
    waiting: bool = True


class ManyStep:
    """Upload of many files, a list of them with a status each, and their measurement.

    Parameters
    ----------
    desk : Desk
    grown : function
        Called after each file that was measured.
    chosen : function
        Called with the folder of a capsule that shall be identified.
    """

    def __init__(self, desk: Desk, grown: Callable[[], object], chosen: Callable[[Path], Awaitable[None]]) -> None:
        self.desk, self._grown, self._chosen = desk, grown, chosen
        self._files: list[_File] = []
        self._running: asyncio.Task[None] | None = None
        with ui.card().classes("bench-step bench-many"):
            ui.html("<h2>Many capsules: films, .rtdc files, several pictures</h2>", sanitize=False)
            ui.label("They are measured with the channel and the liquid of step 3, and added to all capsules.")
            ui.label(
                "Each capsule has a velocity of its own, which a film shows: state the flow rate in step 3, or the "
                "velocity next to each picture. One velocity for the events of a file needs its spread as the error."
            )
            upload = ui.upload(
                label="Drop files here, or choose them with +",
                multiple=True,
                auto_upload=True,
                max_file_size=MOST_BYTES,
                on_upload=self._given,
                on_rejected=lambda: ui.notify("A file is larger than 512 MB, or of another kind.", type="negative"),
            )
            upload.props(f'accept="{",".join(KINDS)}" flat bordered').classes("bench-upload").mark("many")
            self._upload = upload
            self._rate = QuantityField("Frame rate of a film", ("Hz",))
            self._pixel = QuantityField("Size of a pixel of an .rtdc file", ("um", "nm"))
            self._flow = ui.select(_FLOWS, label="Flow in all of them", value="")
            self._flow.props("dense outlined").classes("bench-choice")
            with ui.row():
                self._start = ui.button("Measure them all", on_click=self._pressed).props("no-caps")
                self._stop = ui.button("Stop", on_click=self._stopped).props("outline no-caps")
            self._message = ui.label().classes("bench-message").props('role="status"')
            self._progress = Progress()
            self._list = ui.column().classes("bench-files").props('aria-live="polite"')
            self._lines = ui.html("", sanitize=False)
        self._start.enabled = self._stop.enabled = False

    async def _given(self, event: events.UploadEventArguments) -> None:
        """Keep a file in a folder of its own, and show it."""
        name = safe_name(event.file.name)
        if name is None:
            self._message.text = f"{event.file.name}: expected one of {', '.join(KINDS)}."
            return
        folder = new_folder(self.desk.bench.folder, name.rpartition(".")[0])
        await event.file.save(folder / name)
        try:
            seen = await self.desk.bench.measuring.run("shown", folder=str(folder), name=name)
        except WorkFailedError as error:
            shutil.rmtree(folder)
            self._message.text = str(error)
            return
        of_events = name.endswith(EVENTS)
        film, velocity = seen["count"] > 1 and not of_events, None
        what = {True: "frames", False: "events"}[film]
        with self._list, ui.element("div").classes("bench-file") as row:
            ui.html(f'<img src="{seen["src"]}" alt="{html.escape(name)}">', sanitize=False)
            with ui.element("div"):
                count = f", {seen['count']} {what}" if seen["count"] > 1 else ""
                ui.label(f"{name}: {seen['columns']} x {seen['rows']} px{count}")
                if not film:
                    label = "Velocity shared by all events, ± its spread" if of_events else "Velocity of this capsule"
                    velocity = QuantityField(label, ("mm/s", "um/s", "m/s"))
                status = ui.label("waits").classes("bench-told")
        self._files.append(_File(folder, name, velocity, status, row))
        self._start.enabled = self._running is None

    def _pressed(self) -> None:
        self._running = asyncio.create_task(self._measured())

    def _stopped(self) -> None:
        if self._running is not None:
            self._running.cancel()

    async def _measured(self) -> None:
        """Measure the files that wait, one after the other."""
        rate, tension = self.desk.stated.flow_rate, self.desk.experiment.get("viscous_tension")
        stated = OfMany(rate, self._rate.text, self._pixel.text, self._flow.value or "")
        done: list[tuple[Path, list[str]]] = []
        self._start.enabled, self._stop.enabled = False, True
        try:
            with self._progress:
                for file in [file for file in self._files if file.waiting]:
                    missing = self.desk.keep_experiment(file.folder)
                    self._message.text = missing and f"{missing} See step 3."
                    if missing:
                        return
                    velocity = file.velocity.text if file.velocity is not None and not tension else ""
                    if not (velocity or rate or tension or file.velocity is None):
                        file.status.text = _NO_VELOCITY
                        file.status.classes(replace="bench-message")
                        continue
                    words = stated.command(file.name, film=file.velocity is None, velocity=velocity)
                    if await self._one(file, words):
                        done.append((file.folder, words))
        finally:
            self._running, self._stop.enabled = None, False
            self._start.enabled = any(file.waiting for file in self._files)
            lines = "\n".join(f"cd {shlex.quote(str(folder))}; {shlex.join(words)}" for folder, words in done)
            shown = "In a terminal, these lines do the same:<pre class='bench-commands' tabindex='0'>"
            self._lines.content = f"{shown}{html.escape(lines)}</pre>" if done else ""

    async def _one(self, file: _File, words: list[str]) -> bool:
        """Measure a file; return whether a capsule was measured in it."""

        def watch(done: float, total: float | None, what: str) -> None:
            self._progress.show(done, total, f"{what} of {file.name}")

        file.status.text = "is measured"
        try:
            status, printed = await printed_by(words[1:], file.folder, watch, limited=True)
        except asyncio.CancelledError:
            file.status.text = "waits"
            raise
        measured = sorted(file.folder.glob("**/measurement.toml"))
        if status == 0 and measured:
            file.waiting = False
            file.status.text = printed.strip().splitlines()[-1]
            file.status.classes(replace="bench-status good")
            self._show(file, measured)
            self._grown()
            return True
        file.status.text = said(" ".join(printed.split()[-40:]) if status == 2 else printed.strip().splitlines()[-1])
        file.status.classes(replace="bench-message")
        return False

    def _show(self, file: _File, measured: list[Path]) -> None:
        """Link to the overlays of what was measured, so that a person can look, and choose one to be identified."""
        with file.row, ui.element("div"):
            for path in measured[:_MOST_SHOWN]:
                overlay = path.with_name(OVERLAY)
                if overlay.is_file():
                    words = path.parent.name if path.parent != file.folder else "overlay"
                    ui.link(words, self.desk.bench.offer(overlay), new_tab=True)
                    choose = ui.button("Identify", on_click=partial(self._chosen, path.parent)).props(
                        "flat dense no-caps"
                    )
                    choose.props(f'aria-label="Identify {words} of {file.name}"')


_MOST_SHOWN = 12
_NO_VELOCITY = (
    "Its velocity is missing: that of step 3 is of one capsule. Type the file's own, or the flow rate in step 3."
)
