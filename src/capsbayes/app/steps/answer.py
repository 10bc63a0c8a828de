"""Steps four and five: shear modulus and radius, and what is saved of them."""

from __future__ import annotations

import html
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from nicegui import ui

from capsbayes.app.desk import Desk
from capsbayes.app.overlay import Overlay
from capsbayes.app.worker import WorkFailedError

_MEMBRANES = {"": "neo-Hookean", "Skalak": "Skalak", "Blatz-Ko": "Blatz-Ko", "unknown": "unknown"}
_ENGINES = {"quadrature": "on a grid (quick)", "emcee": "sampled (emcee), checked on a grid"}


class AnswerStep:
    """Identification, its result in numbers and words, and saving.

    Parameters
    ----------
    desk : Desk
    overlay : Overlay
        On which the predicted outline is drawn.
    saved : function
        Called once a capsule was saved, with its G_s and a: medians and standard deviations.
    """

    def __init__(self, desk: Desk, overlay: Overlay, saved: Callable[[dict[str, Any]], object]) -> None:
        self.desk, self._overlay, self._saved = desk, overlay, saved
        self._found: dict[str, Any] = {}
        with ui.card().classes("bench-step"):
            ui.html("<h2>4. Shear modulus and radius</h2>", sanitize=False)
            with ui.row():
                self._membrane = ui.select(_MEMBRANES, label="Law of the membrane", value="")
                self._engine = ui.select(_ENGINES, label="Computed", value="quadrature")
            for choice in (self._membrane, self._engine):
                choice.props("dense outlined").classes("bench-choice").on_value_change(self.stale)
            self._button = ui.button("Identify", on_click=self._identify).props("no-caps")
            self._why = ui.label().classes("bench-message")
            self._waiting = ui.linear_progress(show_value=False).props('indeterminate aria-label="computing"')
            self._waiting.visible = False
            self._stop = ui.button("Stop", on_click=self._stopped).props("outline no-caps")
            self._stop.bind_visibility_from(self._waiting, "visible")
            self._result = ui.column().classes("bench-result").props('aria-live="polite"')
        with ui.card().classes("bench-step"):
            ui.html("<h2>5. Save</h2>", sanitize=False)
            self._save = ui.button("Save the report and all files", on_click=self._write).props("no-caps")
            self._files = ui.column().classes("bench-result").props('aria-live="polite"')
        self.allow("Give a picture first.")

    def allow(self, missing: str) -> None:
        """Let the capsule be identified, or say what is missing."""
        self._button.enabled, self._why.text = not missing, missing
        self.stale()

    def stale(self) -> None:
        """Forget what was computed from other statements."""
        self._found = {}
        self._save.enabled = False
        self._result.clear()
        self._files.clear()
        self._overlay.predict(None)

    async def _identify(self) -> None:
        self.stale()
        stated = self.desk.stated
        stated.membrane, stated.engine = self._membrane.value or "", self._engine.value or "quadrature"
        asked = replace(stated), dict(self.desk.experiment), self.desk.folder
        self._button.enabled, self._waiting.visible = False, True
        try:
            found = await self.desk.identified("identified", stated=asked[0])
            if asked != (self.desk.stated, self.desk.experiment, self.desk.folder):
                return  # something else was stated meanwhile
            self._found = found
            self._show()
            self._save.enabled = True
            picture = await self.desk.identified("corner", stated=asked[0])
            if self._found is found:
                with self._result:
                    ui.html(picture, sanitize=False).classes("bench-corner")
        except WorkFailedError as error:
            with self._result:
                ui.label(str(error)).classes("bench-message")
        finally:
            self._button.enabled, self._waiting.visible = True, False

    def _stopped(self) -> None:
        self.desk.bench.identifying.stop()

    def _show(self) -> None:
        found = self._found
        self._overlay.predict(found["predicted"])
        good = "good" if found["ok"] else "bad"
        with self._result:
            headlines = "".join(f"<p class='bench-headline'>{text}</p>" for text in found["headlines"])
            ui.html(headlines, sanitize=False).mark("headline")
            ui.label(found["status"]).classes(f"bench-status {good}")
            if found["caveats"]:
                items = "".join(f"<li>{text}</li>" for text in found["caveats"])
                ui.html(f"<ul>{items}</ul>", sanitize=False)
            ui.html(found["quantities"], sanitize=False).classes("bench-wide")
            ui.html(f"<p>{found['budget_sentence']}</p>{found['budget']}", sanitize=False).classes("bench-wide")
            with ui.expansion("Checks of the computation"):
                ui.html(found["gates"], sanitize=False).classes("bench-wide")

    async def _write(self) -> None:
        self._save.enabled, self._waiting.visible = False, True
        self._files.clear()
        folder = self.desk.folder
        assert folder is not None, "of an identified capsule"
        try:
            names = await self.desk.identified("saved", stated=self.desk.stated)
        except WorkFailedError as error:
            with self._files:
                ui.label(str(error)).classes("bench-message")
            return
        finally:
            self._save.enabled, self._waiting.visible = True, False
        with self._files:
            ui.label(f"Saved in {folder}.").classes("bench-status good")
            address = self.desk.bench.offer(folder / "report.html")
            ui.link("Open the report", address, new_tab=True).mark("report")
            ui.label(f"Files: {', '.join(names)}.")
            ui.label("In a terminal, these lines make the same files:")
            lines = html.escape("\n".join(self.desk.stated.commands(folder)))
            ui.html(f"<pre class='bench-commands' tabindex='0'>{lines}</pre>", sanitize=False)
        self._saved(self._found["summary"])
