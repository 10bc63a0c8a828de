"""A bar of progress on the page, seen while something is computed."""

from __future__ import annotations

from types import TracebackType

from nicegui import ui


class Progress:
    """The bar, and how much is done in words; ``with`` shows it."""

    def __init__(self) -> None:
        with ui.column().classes("bench-progress") as self._all:
            self._bar = ui.linear_progress(show_value=False).props('indeterminate aria-label="computing"')
            self._words = ui.label().classes("bench-told")
        self._all.visible = False

    def show(self, done: float, total: float | None, what: str) -> None:
        """Show how much of something is done."""
        self._bar.props(remove="indeterminate" if total else "", add="" if total else "indeterminate")
        self._bar.value = done / total if total else 0.0
        self._words.text = f"{done:g} of {total:g} {what}" if total else f"{done:g} {what}"

    def __enter__(self) -> None:
        self._bar.props("indeterminate")
        self._words.text = ""
        self._all.visible = True

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._all.visible = False
