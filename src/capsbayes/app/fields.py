"""Parts of the page: a step, fields, uploads, a bar of progress, lines for a terminal, and the picture."""

from __future__ import annotations

import contextlib
import html
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from nicegui import ui
from nicegui.element import Element
from nicegui.events import GenericEventArguments

from capsbayes.app.desk import MOST_BYTES, MOST_MB
from capsbayes.app.stated import page_words
from capsbayes.app.worker import WorkFailedError
from capsbayes.errors import InputError
from capsbayes.parameters import PARAMETERS
from capsbayes.quantity import Quantity

_PAIR = re.compile(r"^\s*(?P<value>[^\s+]+)(?:\s*\+/-\s*(?P<error>\S+))?(?:\s+(?P<unit>\S.*))?$")
_WITH_UNIT = re.compile(r"[^\W\d_eE]|°")  # a letter that is no exponent's
_COMMA = re.compile(r"(?<![\d.,])(0|\d+(?!,\d{3}(?!\d))),(\d+)(?![\d.,])")
_EXPONENT = re.compile(r"\de[+-]?\d", re.IGNORECASE)
_ROUNDED = 1e-5  # of a number of a file
FLOWS = {"": "found from the shape", "right": "to the right", "left": "to the left"}


def step(title: str) -> ui.card:
    """Return the card of a step of the page, to be filled."""
    with ui.card().classes("bench-step") as card:
        ui.html(f"<h2>{title}</h2>", sanitize=False)
    return card


def notice(kind: str = "bench-told") -> ui.label:
    """Return a label that says how something went, also to a reader of screens."""
    return ui.label().classes(kind).props('role="status"')


def result() -> ui.column:
    """Return the place of a result, which a reader of screens reads out."""
    return ui.column().classes("bench-result").props('aria-live="polite"')


def choice(label: str, options: Any, value: str, **how: Any) -> ui.select:
    """Return a field with options to choose from."""
    return ui.select(options, label=label, value=value, **how).props("dense outlined").classes("bench-choice")


def button(text: str, pressed: Callable[..., Any], look: str = "outline ") -> ui.button:
    """Return a button."""
    return ui.button(text, on_click=pressed).props(f"{look}no-caps")


def upload(label: str, kinds: Sequence[str], given: Callable[..., Any], mark: str, **how: Any) -> ui.upload:
    """Return a place to drop files of some kinds, which says why it rejects others."""
    causes = {"accept": f"is of another kind than {', '.join(kinds)}", "max-file-size": f"has over {MOST_MB} MB"}

    def told(event: GenericEventArguments) -> None:
        for name, cause in event.args:
            ui.notify(f"{name} {causes.get(cause, 'was given before')}.", type="negative", timeout=10_000)

    place = ui.upload(label=label, auto_upload=True, on_upload=given, max_file_size=MOST_BYTES, **how)
    place.on("rejected", told, js_handler="(all) => emit(all.map((one) => [one.file.name, one.failedPropValidation]))")
    return place.props(f'accept="{",".join(kinds)}" flat bordered').classes("bench-upload").mark(mark)


def show_lines(text: str) -> None:
    """Show what is printed, or lines of a terminal, as they are."""
    ui.html(f"<pre class='bench-commands' tabindex='0'>{html.escape(text)}</pre>", sanitize=False).classes("bench-wide")


def show_commands(lines: Iterable[str], what: str) -> None:
    """Show commands, and what they do."""
    ui.label(f"In a terminal, these lines {what}:")
    show_lines("\n".join(lines))


def explained(what: str, words: str) -> None:
    """Show a button that opens an explanation beside a field."""
    about = ui.button(icon="help_outline").props(f'flat round dense size=sm aria-label="What is this: {what}"')
    with about, ui.menu().classes("bench-help").props('anchor="bottom right" self="top right"'):
        ui.label(words)


def refusal(text: str, read: Callable[[str], object]) -> str | None:
    """Return what is wrong with a text by the function that reads it; None if it is right or empty."""
    try:
        if text:
            read(text)
    except InputError as error:
        return page_words(f"Expected {error.expected}, got {error.got}")
    return None


class QuantityField:
    """A number, its standard error and its unit, which together are a text like "25.0 +/- 0.2 um".

    The first of the units is there at the beginning; a ratio has none. With the name of its parameter it is checked
    when it is left.
    """

    def __init__(
        self,
        label: str,
        units: Sequence[str] = (),
        changed: Callable[[], object] = lambda: None,
        *,
        name: str = "",
        words: str = "",
    ) -> None:
        self._name, self._label, self._units = name, label, units
        with ui.row(wrap=False).classes("bench-quantity"):
            self._value = ui.input(label, on_change=changed).classes("value")
            self._value.props("dense outlined hide-bottom-space no-error-icon")
            ui.label("±").classes("sign")
            self._error = ui.input("error", on_change=changed).classes("error")
            self._error.props(f'dense outlined aria-label="{label}, error"')
            self._unit = None
            if units:
                shown = {unit: re.sub("^u", "µ", unit) for unit in units}
                self._unit = ui.select(shown, value=units[0], on_change=changed).classes("unit")
                self._unit.props(f'dense outlined aria-label="{label}, unit"')
            if words:
                explained(label, words)
        for part in (self._value, self._error, self._unit):
            if part is not None and name:
                part.on("blur", self._check)

    def _check(self) -> None:
        self._value.error = refusal(self.text, lambda text: Quantity.of_text(text, self._name, where="", key=""))

    @property
    def text(self) -> str:
        """The quantity as a text, empty where no number is given; a number that has a unit keeps it."""
        value, error = with_point(self._value.value), with_point(self._error.value)
        if not value:
            return value
        stated = f"{value} +/- {error}" if error else value
        return stated if self._unit is None or _WITH_UNIT.search(value) else f"{stated} {self._unit.value}"

    @text.setter
    def text(self, text: str) -> None:
        self._value.error = None
        pair = _PAIR.match(self._without_exponent(text))
        unit = "" if pair is None else pair["unit"] or ""
        if pair is None or unit not in ([""] if self._unit is None else self._unit.options):
            self._value.value, self._error.value = text, ""
            return
        if self._unit is not None:
            self._unit.value = unit
        self._value.value, self._error.value = pair["value"], pair["error"] or ""

    def differs(self, text: str) -> str:
        """Return in words how the number that a file states differs from that of the field; nothing if it does not."""
        with contextlib.suppress(InputError):  # the field is empty, or says itself what is wrong
            typed, stated = (
                Quantity.read(one, where="", key="", units=self._units[:1], example="") for one in (self.text, text)
            )
            if abs(typed.value - stated.value) > typed.error + _ROUNDED * stated.value:
                return f"{self._label}: the file states {text}, the field {self.text}.".replace(" u", " µ")
        return ""

    def _without_exponent(self, text: str) -> str:
        """Return a quantity like 2.5e-05 +/- 2e-07 m in the unit that people write it in."""
        with contextlib.suppress(InputError):
            if self._unit is not None and self._name and _EXPONENT.search(text):
                read, parameter = Quantity.of_text(text, self._name, where="", key=""), PARAMETERS[self._name]
                numbers = [f"{parameter.shown(number):.12g}" for number in (read.value, read.error) if number]
                if read.shape == "normal":
                    return f"{' +/- '.join(numbers)} {parameter.shown_unit.replace('µ', 'u')}"
        return text


def with_point(text: str | None) -> str:
    """Return a text with a decimal point for a decimal comma; one before three digits may be of thousands, and stays.

    Examples
    --------
    >>> with_point("0,85 "), with_point("1,234"), with_point("0,125")
    ('0.85', '1,234', '0.125')
    """
    return _COMMA.sub(r"\1.\2", text or "").strip()


class Progress:
    """A bar, and how much is done in words."""

    def __init__(self) -> None:
        with ui.column().classes("bench-progress") as self._all:
            self._bar = ui.linear_progress(show_value=False).props('indeterminate aria-label="computing"')
            self._words = ui.label().classes("bench-told")
        self._all.visible = False

    def show(self, done: float, total: float | None, what: str, of: str = "") -> None:
        """Show how much of something is done."""
        self._bar.props(remove="indeterminate" if total else "", add="" if total else "indeterminate")
        self._bar.value = done / total if total else 0.0
        self._words.text = (f"{done:g} of {total:g} {what}" if total else f"{done:g} {what}") + of

    @contextlib.contextmanager
    def shown(self, words: str = "") -> Iterator[None]:
        """Show it while something is computed."""
        self._bar.props("indeterminate")
        self._words.text, self._all.visible = words, True
        try:
            yield
        finally:
            self._all.visible = False


@contextlib.contextmanager
def waiting(words: str, *pressed: ui.button) -> Iterator[None]:
    """Show a bar with words in this place, and no button that can be pressed again; say what failed."""
    with ui.column().classes("bench-result") as place:
        progress = Progress()
    for each in pressed:
        each.props("loading")
    try:
        with progress.shown(words):
            yield
    except WorkFailedError as error:
        ui.notify(str(error), type="negative", timeout=0, close_button="Close")
    finally:
        if not place.is_deleted:
            place.delete()
        for each in pressed:
            each.props(remove="loading")


class Overlay(Element, component="overlay.js"):
    """A picture with lines over it, with walls that can be dragged, and boxes that can be drawn.

    The first function is called with the rows of the upper and the lower wall at both borders once a wall was moved,
    the second with left column, upper row, width and height of a box that was drawn.
    """

    def __init__(self, on_walls: Callable[[list[float]], Any], on_box: Callable[[list[float]], Any]) -> None:
        super().__init__()
        self._props.update(rows=1, columns=1)  # until there is a picture
        self.on("walls", lambda event: on_walls(event.args))
        self.on("box", lambda event: on_box(event.args))

    def show(self, picture: dict[str, Any]) -> None:
        """Show another picture, without lines."""
        self.put(**{key: picture[key] for key in ("src", "rows", "columns", "pixel")})
        self.draw({})

    def draw(self, lines: dict[str, Any], *, by_hand: bool = False) -> None:
        """Draw lines, and remove those that are not given."""
        names = ("walls", "outline", "rear", "predicted", "crop", "erased")
        self.put(**{name: lines.get(name) for name in names}, **{"by-hand": by_hand})
        self.update()  # also where nothing has changed but walls that were moved on the page

    def put(self, **properties: Any) -> None:
        """Change properties of the component: ``predicted``, the predicted outline, or ``drawing``, to draw a box."""
        if any(self._props.get(name) != value for name, value in properties.items()):  # it sends the picture too
            self._props.update(properties)
            self.update()
