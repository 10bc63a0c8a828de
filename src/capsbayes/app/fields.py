"""Fields of a form: a number with its error and its unit, which together are a text like "25.0 +/- 0.2 um"."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from nicegui import ui

_PAIR = re.compile(r"^\s*(?P<value>[^\s+]+)(?:\s*\+/-\s*(?P<error>\S+))?(?:\s+(?P<unit>\S.*))?$")
_WITH_UNIT = re.compile(r"[^\W\d_eE]|°")  # a letter that is no exponent's


class QuantityField:
    """A number, its standard error and its unit.

    Parameters
    ----------
    label : str
    units : sequence of str
        Units to choose from, the first of which is there at the beginning; empty for a ratio.
    changed : function, optional
        Called after a change.
    """

    def __init__(self, label: str, units: Sequence[str], changed: Callable[[], object] | None = None) -> None:
        def told() -> None:
            if changed is not None:
                changed()

        with ui.row(wrap=False).classes("bench-quantity"):
            self._value = ui.input(label, on_change=told).props("dense outlined").classes("value")
            ui.label("±").classes("sign")
            self._error = ui.input("error", on_change=told).props(f'dense outlined aria-label="{label}, error"')
            self._error.classes("error")
            self._unit = None
            if units:
                shown = {unit: unit.replace("um", "µm").replace("us", "µs") for unit in units}
                chosen = ui.select(shown, value=units[0], on_change=told)
                self._unit = chosen.props(f'dense outlined aria-label="{label}, unit"').classes("unit")

    @property
    def text(self) -> str:
        """The quantity as a text, empty where no number is given; a number that has a unit keeps it."""
        value, error = (self._value.value or "").strip(), (self._error.value or "").strip()
        if not value:
            return value
        stated = f"{value} +/- {error}" if error else value
        return stated if self._unit is None or _WITH_UNIT.search(value) else f"{stated} {self._unit.value}"

    @text.setter
    def text(self, text: str) -> None:
        found = _PAIR.match(text)
        unit = "" if found is None else found["unit"] or ""
        known = self._unit is None and not unit
        if found is not None and self._unit is not None and unit in (self._unit.options or []):
            known = True
            self._unit.value = unit
        self._value.value = found["value"] if found is not None and known else text
        self._error.value = (found["error"] or "") if found is not None and known else ""
