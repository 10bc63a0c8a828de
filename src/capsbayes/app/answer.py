"""Steps four and five: shear modulus and radius, and what is saved of them."""

from __future__ import annotations

from asyncio import Future
from collections.abc import Callable
from dataclasses import replace
from functools import partial

from nicegui import ui

from capsbayes.app import fields
from capsbayes.app.desk import Computed, Desk
from capsbayes.app.fields import Overlay, button, choice, result

_MEMBRANES = {"": "neo-Hookean", "Skalak": "Skalak", "Blatz-Ko": "Blatz-Ko", "unknown": "unknown"}
_ENGINES = {"quadrature": "on a grid (quick)", "emcee": "sampled (emcee), checked on a grid"}
_PRIORS = {
    "surface_shear_modulus": (
        "Prior of the shear modulus",
        "What is known of the membrane from another experiment: 50 ± 10 mN/m, 20 .. 80 mN/m, or log-uniform "
        "1 .. 1000 mN/m. Left empty: log-uniform 0.1 .. 10000 mN/m.",
    ),
    "capsule_radius": (
        "Prior of the radius",
        "What is known of the size from elsewhere, as from a picture of the capsule at rest: 24 ± 1 µm, or "
        "20 .. 30 µm. Left empty: 1 .. 1000 µm.",
    ),
}


def _wrong_prior(name: str, text: str) -> str | None:
    def read(text: str) -> object:
        from capsbayes.infer import Prior  # slow to import

        return Prior().with_texts({name: text})

    return fields.refusal(fields.with_point(text), read)


class AnswerStep:
    """Identification, its result in words and on the overlay, and saving.

    The function is called once a capsule was identified, and with its G_s and a, medians and standard deviations, once
    it was saved.
    """

    def __init__(self, desk: Desk, overlay: Overlay, grown: Callable[..., object]) -> None:
        self.desk, self._overlay, self._grown = desk, overlay, grown
        self._shown: Computed | None = None
        self._awaited: Computed | None = None
        with fields.step("4. Shear modulus and radius"):
            with ui.row():
                self._how: dict[str, ui.select | ui.input] = {
                    "membrane": choice("Law of the membrane", _MEMBRANES, "", on_change=self._read),
                    "engine": choice("Computed", _ENGINES, "quadrature", on_change=self._read),
                }
            with ui.expansion("More: what is known beforehand") as self._more:
                for name, (label, words) in _PRIORS.items():
                    with ui.row(wrap=False).classes("bench-quantity"):
                        field = ui.input(label, on_change=self._read, validation=partial(_wrong_prior, name))
                        field.without_auto_validation().on("blur", field.validate)
                        self._how[name] = field.classes("col").props("dense outlined hide-bottom-space no-error-icon")
                        fields.explained(label, words)
            self._button = button("Identify", self._identify, "")
            self._why = ui.label().classes("bench-message")
            self._waiting = ui.linear_progress(show_value=False).props('indeterminate aria-label="computing"')
            self._waiting.visible = False
            self._stop = button("Stop", lambda: desk.bench.identifying.stop())
            self._stop.bind_visibility_from(self._waiting, "visible")
            self._result = result()

    def closer(self) -> None:
        """Build step five."""
        with fields.step("5. Look closer, and save"):
            self._save = button("Save the report and all files", self._write, "")
            self._save.enabled = False
            self._files = result()
            self._details = result().classes("bench-details")
        self.allow("Give a picture first.")

    def allow(self, missing: str) -> None:
        """Let the capsule be identified as it is stated now, or say what is missing."""
        self._why.text, stated = missing, replace(self.desk.stated)
        for name, field in self._how.items():
            if fields.with_point(field.value) != getattr(stated, name):
                field.value = getattr(stated, name)
                self._more.value |= bool(stated.priors())
        self._refresh()

    def _read(self) -> None:
        """Take over what the fields state."""
        for name, field in self._how.items():
            setattr(self.desk.stated, name, fields.with_point(field.value))
        self.desk.keep()
        self._refresh()

    def _identify(self) -> None:
        self.desk.identify()
        self._refresh()

    def _refresh(self) -> None:
        """Show the result of what is stated, whichever page asked for it, or that it is computed."""
        folder, computed, same, running = self.desk.folder, None, False, False
        wrong = any(_wrong_prior(name, text) for name, text in self.desk.stated.priors().items())
        ready = not (self._why.text or wrong)
        if folder is not None and (computed := self.desk.bench.computed.get(folder)) is not None:
            same, running = ready and computed.asked == self.desk.stated.asked(folder), not computed.answer.done()
            if running and computed is not self._awaited:
                self._awaited = computed
                computed.answer.add_done_callback(self._ended)
        self._waiting.visible, self._button.enabled = running, ready and not (running and same)
        shown = computed if same and not running else None
        if shown is not self._shown:
            self._shown, self._save.enabled = shown, False
            for part in (self._result, self._files, self._details):
                part.clear()
            self._overlay.put(predicted=None)
            if shown is not None:
                self._show(shown)

    def _ended(self, _: object) -> None:
        if not self._result.is_deleted:  # the page is still open
            self._refresh()
            self._grown()

    def _show(self, computed: Computed) -> None:
        if (error := computed.answer.exception()) is not None:
            with self._result:
                ui.label(str(error)).classes("bench-message")
            return
        answer, self._save.enabled = computed.answer.result(), True
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
                fields.show_commands(self.desk.stated.commands(computed.folder), "make the files that are saved")
                ui.label("Or in Python:")
                fields.show_lines(self.desk.stated.script(computed.folder))
        with self._details:
            corner = ui.html("", sanitize=False).classes("bench-corner")

        def drawn(picture: Future[str]) -> None:
            if not corner.is_deleted:
                corner.content = picture.result()

        computed.corner.add_done_callback(drawn)

    async def _write(self) -> None:
        shown = self._shown
        assert shown is not None, "of an identified capsule"
        self._files.clear()
        with self._files, fields.waiting("The report is written", self._save):
            names = await shown.run("saved")
            ui.label(f"Saved in {shown.folder}.").classes("bench-status good")
            address = self.desk.bench.offer(shown.folder / "report.html")
            ui.link("Open the report", address, new_tab=True).mark("report")
            ui.label(f"Files: {', '.join(names)}.")
            self._grown(shown.answer.result()["summary"])
