"""Step six: all saved capsules together, the next flow rate, and what the model misses."""

from __future__ import annotations

import html
import shlex
from pathlib import Path
from typing import Any

from nicegui import ui

from capsbayes.app.bar import Progress
from capsbayes.app.command import printed_by
from capsbayes.app.desk import Desk
from capsbayes.app.stated import MEASUREMENT

_ENOUGH = 10  # capsules for a diagnosis, half of which are held out


class PopulationStep:
    """Commands over the folder of all capsules, run as processes of their own."""

    def __init__(self, desk: Desk) -> None:
        self.desk = desk
        self._last: tuple[Path, dict[str, Any]] | None = None
        with ui.card().classes("bench-step"):
            ui.html("<h2>6. All capsules</h2>", sanitize=False)
            self._count = ui.label()
            with ui.row():
                self._together = self._button("Look at all together", self._population)
                self._flow = self._button("At which flow rate next?", self._design)
                self._diagnose = self._button("What does the model miss?", self._diagnosis)
            self._waiting = Progress()
            self._result = ui.column().classes("bench-result").props('aria-live="polite"')
        self.grown()

    def grown(self, summary: dict[str, Any] | None = None) -> None:
        """Count the saved capsules; the last one is that of a summary, if there is one."""
        if summary is not None and self.desk.folder is not None:
            self._last = self.desk.folder, summary
        count = len(list(self.desk.bench.folder.glob("*/**/measurement.toml")))
        self._count.text = f"{count} capsule{'' if count == 1 else 's'} in {self.desk.bench.folder}."
        self._together.enabled = count > 0
        self._flow.enabled = self._last is not None
        self._diagnose.enabled = count >= _ENOUGH
        more = "" if count >= _ENOUGH else f" from {_ENOUGH} capsules on"
        self._diagnose.text = f"What does the model miss?{more}"

    def _button(self, text: str, pressed: Any) -> ui.button:
        return ui.button(text, on_click=pressed).props("outline no-caps")

    async def _population(self) -> None:
        where = self.desk.bench.folder
        batch = ["capsbayes", "batch", ".", "--out", "population.nc", "--check", "0"]
        report = ["capsbayes", "report", "population.nc", "--out", "population.html"]
        await self._run([batch, report], where / "population.html")

    async def _design(self) -> None:
        assert self._last is not None, "the button waits for a saved capsule"
        folder, summary = self._last
        modulus, radius = (summary[name] for name in ("surface_shear_modulus", "capsule_radius"))
        measured = (folder / MEASUREMENT).relative_to(self.desk.bench.folder).as_posix()  # film/capsule-1/... too
        expected = [
            "--shear-modulus", f"{1e3 * modulus[0]:.3g} +/- {1e3 * modulus[1]:.2g} mN/m",
            "--radius", f"{1e6 * radius[0]:.4g} +/- {1e6 * radius[1]:.2g} um",
        ]  # fmt: skip
        await self._run([["capsbayes", "sensitivity", "flow", *expected, "--like", measured]])

    async def _diagnosis(self) -> None:
        where = self.desk.bench.folder / "diagnosis"
        await self._run([["capsbayes", "diagnose", ".", "--out", "diagnosis"]], where / "study.html")

    async def _run(self, commands: list[list[str]], page: Path | None = None) -> None:
        """Run commands one after the other in the bench's folder; show what the last one printed, and its page."""
        self._result.clear()
        status, printed = 0, ""
        with self._waiting:
            for words in commands:
                status, printed = await printed_by(words[1:], self.desk.bench.folder, self._waiting.show)
                if status not in (0, 1):
                    break
        with self._result:
            if page is not None and page.is_file() and status in (0, 1):
                ui.link(f"Open {page.name}", self.desk.bench.offer(page), new_tab=True)
            shown = html.escape(printed.strip())
            ui.html(f"<pre class='bench-commands' tabindex='0'>{shown}</pre>", sanitize=False)
            lines = "\n".join(shlex.join(words) for words in (["cd", str(self.desk.bench.folder)], *commands))
            ui.label("In a terminal, these lines do the same:")
            ui.html(f"<pre class='bench-commands' tabindex='0'>{html.escape(lines)}</pre>", sanitize=False)
