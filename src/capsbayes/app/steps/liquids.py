"""Helper for the viscosity: a mixture of water and glycerol, a silicone oil, or methylcellulose in saline."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from nicegui import ui

from capsbayes import experiment as liquids
from capsbayes.app.fields import QuantityField
from capsbayes.app.stated import said
from capsbayes.errors import CapsbayesError
from capsbayes.quantity import Quantity

_DEGREES = "Temperature in °C", ()


class _Liquid(NamedTuple):
    """A liquid of the helper: its fields, the function of their texts, the formula's own error, and what to know."""

    fields: tuple[tuple[str, tuple[str, ...]], ...]
    found: Callable[..., Quantity]
    error: float
    source: str
    told: str


def _medium(share: str) -> _Liquid:
    fields = _DEGREES, ("Flow rate of the liquid", ("uL/s", "uL/min")), ("Half width of its channel", ("um", "mm"))
    told = "It is that at the shear rate of the wall; nearer to the axis it is more. The model is that of"
    return _Liquid(
        fields,
        lambda *texts: liquids.methylcellulose(share, *texts),
        liquids.MEDIUM_ERROR,
        liquids.MEDIUM_SOURCE,
        f"{told} a liquid without shear thinning.",
    )


_LIQUIDS = {
    "water and glycerol": _Liquid(
        (("Mass fraction of glycerol, 0 to 1", ()), _DEGREES),
        liquids.water_glycerol,
        liquids.FORMULA_ERROR,
        liquids.SOURCE,
        "Glycerol takes up water from the air.",
    ),
    "silicone oil": _Liquid(
        (("Viscosity on its bottle, at 25 °C", ("mm^2/s",)), ("Density at 25 °C", ("kg/m^3", "g/cm^3")), _DEGREES),
        liquids.silicone_oil,
        liquids.OIL_ERROR,
        liquids.OIL_SOURCE,
        "For dimethyl silicones of 100 mm²/s and more.",
    ),
    **{f"methylcellulose {share} in saline": _medium(share) for share in liquids.MEDIA},
}


def viscosity_helper(target: QuantityField) -> None:
    """Show the helper, which fills a field."""
    with ui.expansion("Viscosity of a known liquid"):
        ui.label("A rheometer's value with its error, typed in above, is better.")
        choice = ui.select(list(_LIQUIDS), label="Liquid", value=next(iter(_LIQUIDS)))
        choice.props("dense outlined").classes("bench-choice")
        for name, liquid in _LIQUIDS.items():
            with ui.column().classes("bench-result") as shown:
                _form(liquid, target)
            shown.bind_visibility_from(choice, "value", value=name)


def _form(liquid: _Liquid, target: QuantityField) -> None:
    """Show the fields of a liquid, and the button that fills the viscosity in."""
    fields = [QuantityField(*about) for about in liquid.fields]
    ui.button("Use this viscosity", on_click=lambda: fill()).props("outline no-caps")
    told = ui.label().classes("bench-told")

    def fill() -> None:
        try:
            found = liquid.found(*(field.text for field in fields))
        except CapsbayesError as error:
            told.text = said(error)
            return
        target.text = f"{found.value:.4g} +/- {found.error:.2g} Pa s"
        of_formula = f"of which {liquid.error:.0%} is the error of the formula ({liquid.source})"
        told.text = f"{found.value:.4g} ± {found.error:.2g} Pa s, {of_formula}. {liquid.told}"
