"""Steps four and five: shear modulus and radius, and what is saved of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from nicegui import ui

from capsbayes.app.desk import Desk
from capsbayes.app.fields import Overlay, button, choice, result, show_commands, show_lines, step
from capsbayes.app.worker import WorkFailedError

_MEMBRANES = {"": "neo-Hookean", "Skalak": "Skalak", "Blatz-Ko": "Blatz-Ko", "unknown": "unknown"}
_ENGINES = {"quadrature": "on a grid (quick)", "emcee": "sampled (emcee), checked on a grid"}


class AnswerStep:
    """Identification, its result in numbers and words, and saving.

    The predicted outline is drawn on the overlay; the function is called once a capsule was saved, with its G_s and a:
    medians and standard deviations.
    """

    def __init__(self, desk: Desk, overlay: Overlay, saved: Callable[[dict[str, Any]], object]) -> None:
        self.desk, self._overlay, self._saved = desk, overlay, saved
        self._answer: dict[str, Any] = {}
        with step("4. Shear modulus and radius"):
            with ui.row():
                self._membrane = choice("Law of the membrane", _MEMBRANES, "", on_change=self.stale)
                self._engine = choice("Computed", _ENGINES, "quadrature", on_change=self.stale)
            self._button = button("Identify", self._identify, "")
            self._why = ui.label().classes("bench-message")
            self._waiting = ui.linear_progress(show_value=False).props('indeterminate aria-label="computing"')
            self._waiting.visible = False
            self._stop = button("Stop", lambda: desk.bench.identifying.stop())
            self._stop.bind_visibility_from(self._waiting, "visible")
            self._result = result()

    def closer(self) -> None:
        """Build step five."""
        with step("5. Look closer, and save"):
            self._save = button("Save the report and all files", self._write, "")
            self._files = result()
            self._details = result().classes("bench-details")
        self.allow("Give a picture first.")

    def allow(self, missing: str) -> None:
        """Let the capsule be identified, or say what is missing."""
        self._button.enabled, self._why.text = not missing, missing
        self.stale()

    def stale(self) -> None:
        """Forget what was computed from other statements."""
        self._answer = {}
        self._save.enabled = False
        for part in (self._result, self._files, self._details):
            part.clear()
        self._overlay.put(predicted=None)

    async def _identify(self) -> None:
        self.stale()
        stated = self.desk.stated
        stated.membrane, stated.engine = self._membrane.value or "", self._engine.value or "quadrature"
        asked = replace(stated), dict(self.desk.experiment), self.desk.folder
        self._button.enabled, self._waiting.visible = False, True
        try:
            answer = await self.desk.identified("identified", stated=asked[0])
            if asked != (self.desk.stated, self.desk.experiment, self.desk.folder):
                return  # something else was stated meanwhile
            self._answer = answer
            self._show(answer)
            self._save.enabled = True
            picture = await self.desk.identified("corner", stated=asked[0])
            if self._answer is answer:
                with self._details:
                    ui.html(picture, sanitize=False).classes("bench-corner")
        except WorkFailedError as error:
            with self._result:
                ui.label(str(error)).classes("bench-message")
        finally:
            self._button.enabled, self._waiting.visible = True, False

    def _show(self, answer: dict[str, Any]) -> None:
        self._overlay.put(predicted=answer["predicted"])
        with self._result:
            headlines = "".join(f"<p class='bench-headline'>{text}</p>" for text in answer["headlines"])
            ui.html(headlines, sanitize=False).mark("headline")
            ui.html("".join(answer["densities"]), sanitize=False).classes("bench-densities")
            ui.label(answer["status"]).classes(f"bench-status {'good' if answer['ok'] else 'bad'}")
            if answer["caveats"]:
                items = "".join(f"<li>{text}</li>" for text in answer["caveats"])
                ui.html(f"<ul>{items}</ul>", sanitize=False)
            ui.html(f"<p>{answer['budget_sentence']}</p>{answer['budget']}", sanitize=False).classes("bench-wide")
        with self._details, ui.element("div"):
            for title, unfolded in (("All quantities", True), ("Checks of the computation", False)):
                with ui.expansion(title, value=unfolded):
                    ui.html(answer[title], sanitize=False).classes("bench-wide")
            with ui.expansion("The code that does the same"):
                assert self.desk.folder is not None, "of an identified capsule"
                show_commands(self.desk.stated.commands(self.desk.folder), "make the files that are saved")
                ui.label("Or in Python:")
                show_lines(self.desk.stated.script(self.desk.folder))

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
        self._saved(self._answer["summary"])
