"""The steps of many capsules: several files at once, each measured by its command, and all capsules together."""

from __future__ import annotations

import asyncio
import hashlib
import html
import shutil
import tempfile
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from nicegui import events, ui

from capsbayes.app import fields
from capsbayes.app.archive import PACKED
from capsbayes.app.desk import LONGEST, MOST_BYTES, Desk
from capsbayes.app.fields import Progress, QuantityField, button, step
from capsbayes.app.stated import (
    EVENTS,
    KINDS,
    MEASUREMENT,
    OVERLAY,
    STATED,
    enter,
    in_shell,
    measure_command,
    new_folder,
    page_words,
    safe_name,
)
from capsbayes.app.worker import WorkFailedError, printed_by
from capsbayes.report.numbers import counted

_MOST_SHOWN = 12  # overlays of one file
_NO_VELOCITY = (
    "Its velocity is missing: that of step 3 is of one capsule. Type the file's own, or the flow rate in step 3."
)
_ENOUGH = 12  # capsules for a diagnosis, half of which are held out
_MOST_LISTED = 200  # capsules
_REPORT = "report.html"
_BATCH = ["capsbayes", "batch", ".", "--out", "population.nc", "--check", "0"]
_POPULATION = [_BATCH, ["capsbayes", "report", "population.nc", "--out", "population.html"]], "population.html"
_DIAGNOSIS = [["capsbayes", "diagnose", ".", "--out", "diagnosis"]], "diagnosis/study.html"
_TAKEN = (*KINDS, ".zip")


@dataclass
class _File:
    """A file that was given: where it is kept, its velocity unless it is a film, and its row on the page."""

    folder: Path
    name: str
    velocity: QuantityField | None
    status: ui.label
    differs: ui.label
    row: ui.element
    stated: dict[str, str]  # in the file
    waiting: bool = True

    def say(self, text: str, kind: str = "bench-message") -> None:
        self.status.text = text
        self.status.classes(replace=kind)


class ManyStep:
    """Upload of many files, a list of them with a status each, and their measurement.

    The first function is called after each file that was measured, the second with the folder of a capsule that shall
    be identified; the fields are those of step 3.
    """

    def __init__(
        self,
        desk: Desk,
        grown: Callable[[], object],
        chosen: Callable[[Path], Awaitable[None]],
        channel: Mapping[str, QuantityField],
    ) -> None:
        self.desk, self._grown, self._chosen = desk, grown, chosen
        self._files: list[_File] = []
        self._kept: dict[str, Path] = {}  # folders by the hash of the content of the file in them
        self._running: asyncio.Task[None] | None = None
        with step("6. Films, .rtdc files, many pictures").classes("bench-many"):
            ui.label("They are measured as step 3 states, and added to all capsules. What step 7 saved is loaded here.")
            ui.label(
                "Each capsule has a velocity of its own, which a film shows: state the flow rate in step 3, or the "
                "velocity next to each picture. One velocity for the events of a file needs its spread as the error."
            )
            fields.upload("Drop files or a folder here, or choose with +", _TAKEN, self._given, "many", multiple=True)
            self._pixel = QuantityField("Size of a pixel of an .rtdc file", ("um", "nm"))
            self._fields = {**channel, "pixel_size": self._pixel}
            self._flow = fields.choice("Flow in all of them", fields.FLOWS, "")
            with ui.row():
                self._start = button("Measure them all", self._pressed, "")
                self._stop = button("Stop", lambda: self._running and self._running.cancel())
            self._message = fields.notice("bench-message")
            self._progress = Progress()
            self._list = ui.column().classes("bench-files").props('aria-live="polite"')
            self._lines = ui.column().classes("bench-result")
        self._start.enabled = self._stop.enabled = False

    async def _given(self, event: events.UploadEventArguments) -> None:
        """Keep a file in a folder of its own, and show it."""
        name = safe_name(event.file.name, _TAKEN)
        if name is None:
            self._message.text = f"{event.file.name}: expected one of {', '.join(_TAKEN)}."
            return
        if name.endswith(_TAKEN[-1]):
            await self._load(event, name)
            return
        folder = new_folder(self.desk.bench.folder, name.rpartition(".")[0])
        await event.file.save(folder / name)
        with (folder / name).open("rb") as kept:
            sha256 = (await asyncio.to_thread(hashlib.file_digest, kept, "sha256")).hexdigest()
        if (same := self._kept.setdefault(sha256, folder)) != folder:
            shutil.rmtree(folder)
            self._message.text = f"{event.file.name} was given before, as {same.name}, and is left out."
            return
        try:
            seen = await self.desk.bench.measuring.run("shown", folder=str(folder), name=name)
        except WorkFailedError as error:
            self._forget(folder)
            self._message.text = str(error)
            return
        of_events = name.endswith(EVENTS)
        film, velocity = seen["count"] > 1 and not of_events, None
        with self._list, ui.element("div").classes("bench-file") as row:
            ui.html(f'<img src="{seen["src"]}" alt="{html.escape(name)}">', sanitize=False)
            with ui.element("div"):
                count = f", {seen['count']} {'frames' if film else 'events'}" if seen["count"] > 1 else ""
                ui.label(f"{name}: {seen['columns']} x {seen['rows']} px{count}")
                if not film:
                    label = "Velocity shared by all events, ± its spread" if of_events else "Velocity of this capsule"
                    velocity = QuantityField(label, ("mm/s", "um/s", "m/s"))
                status = ui.label("waits").classes("bench-told")
                differs = fields.notice()
                button("Remove", lambda: self._removed(file), f'flat dense aria-label="Remove {name}" ')
        file = _File(folder, name, velocity, status, differs, row, seen["stated"])
        self._files.append(file)
        self._compare(file, fill=True)
        self._start.enabled = self._running is None

    async def _load(self, event: events.UploadEventArguments, name: str) -> None:
        """Take back the capsules that were saved in one file."""
        bench, folder = self.desk.bench, str(self.desk.bench.folder)
        private = tempfile.TemporaryDirectory(prefix=".", dir=folder)
        with self._list, fields.waiting(f"{name} is loaded"), private as place:
            await event.file.save(kept := Path(place) / name)
            new, known = await bench.measuring.run("unpacked", seconds=LONGEST, folder=folder, name=str(kept))
            left = f", {known} left out, whose pictures are here already" if known else ""
            words = f"{name}: {counted(new, 'folder')} loaded{left}. Step 7 lists the capsules."
            ui.notify(words, type="positive", timeout=10_000)
        self._grown()

    def _compare(self, file: _File, *, fill: bool = False) -> None:
        """Say in which numbers file and fields differ; `fill` puts those of the file into fields that are empty."""
        moves = self.desk.stated.velocity or self.desk.experiment.get("viscous_tension")  # without a flow rate
        for name, text in file.stated.items():
            if fill and not (self._fields[name].text or (name == "flow_rate" and moves)):
                self._fields[name].text = text
        differ = (self._fields[name].differs(text) for name, text in file.stated.items())
        file.differs.text = " ".join(filter(None, differ))

    def _removed(self, file: _File) -> None:
        """Take a file off the list, and off the disk with what was measured in it."""
        if self._running is None:
            self._files.remove(file)
            file.row.delete()
            self._forget(file.folder)
            self._start.enabled = any(file.waiting for file in self._files)
            self._grown()

    def _forget(self, folder: Path) -> None:
        shutil.rmtree(folder, ignore_errors=True)
        self._kept = {sha256: other for sha256, other in self._kept.items() if other != folder}

    def _pressed(self) -> None:
        self._running = asyncio.create_task(self._measured())

    async def _measured(self) -> None:
        """Measure the files that wait, one after the other."""
        stated = {"flow_rate": self.desk.stated.flow_rate, "pixel_size": self._pixel.text}
        stated["flow"] = self._flow.value or ""
        tension = self.desk.experiment.get("viscous_tension")
        done: list[str] = []
        self._start.enabled, self._stop.enabled = False, True
        try:
            with self._progress.shown():
                for file in [file for file in self._files if file.waiting]:
                    self._compare(file)
                    missing = self.desk.keep(file.folder)
                    self._message.text = missing and f"{missing} See step 3."
                    if missing:
                        return
                    film = file.velocity is None
                    velocity = "" if file.velocity is None or tension else file.velocity.text
                    if not (velocity or stated["flow_rate"] or tension or film):
                        file.say(_NO_VELOCITY)
                        continue
                    words = measure_command(file.name, film=film, velocity=velocity, **stated)
                    if await self._measure(file, words):
                        done += [enter(file.folder), in_shell(words)]
        finally:
            self._running, self._stop.enabled = None, False
            self._start.enabled = any(file.waiting for file in self._files)
            self._lines.clear()
            if done:
                with self._lines:
                    fields.show_commands(done, "do the same")

    async def _measure(self, file: _File, words: list[str]) -> bool:
        """Measure a file; return whether a capsule was measured in it."""
        file.status.text = "is measured"
        try:
            watch = partial(self._progress.show, of=f" of {file.name}")
            status, printed = await printed_by(words[1:], file.folder, watch, limited=True)
        except asyncio.CancelledError:
            file.status.text = "waits"
            raise
        measured = sorted(file.folder.glob("**/measurement.toml"))
        if status == 0 and measured:
            file.waiting = False
            file.say(printed.strip().splitlines()[-1], "bench-status good")
            self._show(file, measured)
            self._grown()
            return True
        file.say(page_words(" ".join(printed.split()[-40:]) if status == 2 else printed.strip().splitlines()[-1]))
        return False

    def _show(self, file: _File, measured: list[Path]) -> None:
        """Link to the overlays of what was measured, so that a person can look, and choose one to be identified."""
        with file.row, ui.element("div"):
            for path in measured[:_MOST_SHOWN]:
                overlay = path.with_name(OVERLAY)
                if overlay.is_file():
                    words = path.parent.name if path.parent != file.folder else "overlay"
                    ui.link(words, self.desk.bench.offer(overlay), new_tab=True)
                    look = f'flat dense aria-label="Identify {words} of {file.name}" '
                    button("Identify", partial(self._chosen, path.parent), look)


class PopulationStep:
    """Step seven: a list of all capsules, commands over their folder, the next flow rate, and what the model misses.

    The function is called with the folder of a capsule that shall be identified.
    """

    def __init__(self, desk: Desk, chosen: Callable[[Path], Awaitable[None]]) -> None:
        self.desk, self._chosen = desk, chosen
        self._last: tuple[Path, dict[str, Any]] | None = None
        self._ticked: set[Path] = set()
        self._running: asyncio.Task[None] | None = None
        with step("7. All capsules"):
            self._count = ui.label()
            with ui.expansion("List of them"):
                ui.label("Tick two or more that were identified, and press Compare.")
                self._list = ui.column().classes("bench-files")
            with ui.row():
                self._compare = button("Compare", self._side_by_side)
                self._together = button("Look at all together", partial(self._start, *_POPULATION))
                self._flow = button("At which flow rate next?", self._design)
                self._diagnose = button("What does the model miss?", partial(self._start, *_DIAGNOSIS))
                self._all = button("Save all in one file", self._save)
            self._waiting = Progress()
            self._stop = button("Stop", lambda: self._running and self._running.cancel())
            self._result = fields.result()
            self._compared = fields.result()
        self._stop.visible = False
        self.grown()

    def grown(self, summary: dict[str, Any] | None = None) -> None:
        """Count the saved capsules; the last one is that of a summary, if there is one."""
        if summary is not None and self.desk.folder is not None:
            self._last = self.desk.folder, summary
        bench, working = self.desk.bench.folder, self._running is not None
        found = {path.parent for path in bench.glob(f"*/**/{MEASUREMENT}")}
        count = len(found)
        self._count.text = f"{counted(count, 'capsule')} in {bench}."
        self._together.enabled = count > 1 and not working
        self._flow.enabled = self._last is not None and not working
        self._diagnose.enabled = count >= _ENOUGH and not working
        self._diagnose.text = "What does the model miss?" + f" from {_ENOUGH} capsules on" * (count < _ENOUGH)
        listed = sorted(found | {path.parent for path in bench.glob(f"*/{STATED}")})[:_MOST_LISTED]
        self._ticked.intersection_update(listed)
        self._list.clear()
        with self._list:
            for folder in listed:
                self._listed(folder, folder.relative_to(bench).as_posix(), counts=folder in found)
        self._compare.enabled = len(self._ticked) > 1

    def _listed(self, folder: Path, name: str, *, counts: bool) -> None:
        """Show a capsule, with what can be done with it."""
        with ui.element("div").classes("bench-file"), ui.element("div"):
            computed, saved = self.desk.bench.computed.get(folder), (folder / _REPORT).is_file()
            found = folder in self.desk.bench.identified()
            words = ", being identified" if computed is not None and not computed.answer.done() else ""
            text = f"{name}{', identified' if found else words}{'' if counts else ', not saved yet'}"
            if found or saved:
                box = ui.checkbox(text, value=folder in self._ticked, on_change=partial(self._tick, folder))
                box.props(f'dense aria-label="Compare {name}"')
            else:
                self._ticked.discard(folder)
                ui.label(text)
            if saved:
                ui.link("report", self.desk.bench.offer(folder / _REPORT), new_tab=True)
            button("Open", partial(self._chosen, folder), f'flat dense aria-label="Open {name} again" ')
            if counts:
                look = f'flat dense aria-label="Remove {name} from all capsules" '
                button("Remove", partial(self._removed, folder), look)

    def _tick(self, folder: Path) -> None:
        """Take a capsule into the comparison, or out of it."""
        self._ticked ^= {folder}
        self._compare.enabled = len(self._ticked) > 1
        self.desk.bench.identifying.start()  # which takes its time

    async def _side_by_side(self) -> None:
        """Show the capsules that are ticked side by side."""
        bench, found = self.desk.bench, self.desk.bench.identified()
        names = {folder.relative_to(bench.folder).as_posix(): folder for folder in sorted(self._ticked)}
        chosen = {name: (str(folder), found.get(folder)) for name, folder in names.items()}
        self._compared.clear()
        with self._compared, fields.waiting(f"{len(chosen)} capsules are compared", self._compare):
            densities, table = await bench.identifying.run("compared", seconds=LONGEST, capsules=chosen)
            ui.html(densities, sanitize=False).classes("bench-densities bench-few")
            shown = ui.html(table, sanitize=False).classes("bench-wide bench-compared")
            shown.props('tabindex=0 role=region aria-label="Capsules side by side"')

    def _removed(self, folder: Path) -> None:
        """Give the measurement of a capsule a name that no command reads; its files stay."""
        (folder / MEASUREMENT).replace(folder / f"removed-{MEASUREMENT}")
        self.grown()

    async def _save(self) -> None:
        """Download the folders of all capsules in one file, which step 6 takes."""
        bench = self.desk.bench
        with self._compared, fields.waiting("All capsules are packed", self._all):
            await bench.measuring.run("packed", seconds=LONGEST, folder=str(bench.folder), most=MOST_BYTES)
            ui.download.from_url(bench.offer(bench.folder / PACKED), time.strftime("capsbayes-bench-%Y-%m-%d.zip"))

    def _design(self) -> None:
        assert self._last is not None, "the button waits for a saved capsule"
        folder, summary = self._last
        modulus, radius = (summary[name] for name in ("surface_shear_modulus", "capsule_radius"))
        measured = (folder / MEASUREMENT).relative_to(self.desk.bench.folder).as_posix()  # film/capsule-1/... too
        expected = [
            "--shear-modulus", f"{1e3 * modulus[0]:.3g} +/- {1e3 * modulus[1]:.2g} mN/m",
            "--radius", f"{1e6 * radius[0]:.4g} +/- {1e6 * radius[1]:.2g} um",
        ]  # fmt: skip
        self._start([["capsbayes", "sensitivity", "flow", *expected, "--like", measured]])

    def _start(self, commands: list[list[str]], page: str = "") -> None:
        self._running = asyncio.create_task(self._run(commands, page))

    async def _run(self, commands: list[list[str]], page: str) -> None:
        """Run commands one after the other in the bench's folder; show what the last one printed, and its page."""
        folder = self.desk.bench.folder
        self._result.clear()
        self._stop.visible = True
        self.grown()
        status, printed = 0, ""
        try:
            with self._waiting.shown():
                for words in commands:
                    status, printed = await printed_by(words[1:], folder, self._waiting.show)
                    if status not in (0, 1):
                        break
        finally:
            self._running, self._stop.visible = None, False
            self.grown()
        with self._result:
            if page and (folder / page).is_file() and status in (0, 1):
                address = self.desk.bench.offer(folder / page)
                ui.link(f"Open {Path(page).name}", address, new_tab=True)
                ui.html(
                    f'<iframe class="bench-page" src=".{address}" title="{Path(page).stem}"></iframe>', sanitize=False
                )
            fields.show_lines(printed.strip())
            fields.show_commands([enter(folder), *map(in_shell, commands)], "do the same")
