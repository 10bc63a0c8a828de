"""The picture on the page, with walls that can be dragged, and boxes that can be drawn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nicegui.element import Element

_LINES = ("walls", "outline", "rear", "predicted", "crop", "erased")


class Overlay(Element, component="overlay.js"):
    """A picture with lines over it.

    Parameters
    ----------
    on_walls : function of four rows
        Called with the rows of the upper and the lower wall at both borders once a wall was moved.
    on_box : function of four numbers
        Called with left column, upper row, width and height of the box that was drawn.
    """

    def __init__(self, on_walls: Callable[[list[float]], Any], on_box: Callable[[list[float]], Any]) -> None:
        super().__init__()
        self._props.update(rows=1, columns=1)  # until there is a picture
        self.on("walls", lambda event: on_walls(event.args))
        self.on("box", lambda event: on_box(event.args))

    def show(self, picture: dict[str, Any]) -> None:
        """Show another picture, without lines."""
        self._props.update({key: picture[key] for key in ("src", "rows", "columns")})
        self.draw()

    def draw(self, **lines: Any) -> None:
        """Draw lines, and remove those that are not given."""
        self._props.update({name: lines.get(name) for name in _LINES})
        self._props["by-hand"] = bool(lines.get("by_hand"))
        self.update()

    def predict(self, outline: list[list[float]] | None) -> None:
        """Draw the predicted outline over the rest."""
        self._props["predicted"] = outline
        self.update()

    def let_draw(self, drawing: bool) -> None:
        """Let the pointer draw a box, or not."""
        self._props["drawing"] = drawing
        self.update()
