"""Step three: channel, liquid, camera and velocity, as the file of the experiment states them."""

from __future__ import annotations

import contextlib
import tomllib
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

from nicegui import events, ui

from capsbayes import experiment as liquids
from capsbayes.app.desk import Desk
from capsbayes.app.fields import QuantityField, button, choice, notice, step, upload
from capsbayes.app.stated import page_words
from capsbayes.errors import CapsbayesError, InputError
from capsbayes.quantity import Quantity

_EXPERIMENT, _CAMERA, _CAPSULE = "experiment", "camera", "capsule"


class _Field(NamedTuple):
    """A field of the form: what it states, in which units, of what, and what a person should know of it."""

    label: str
    units: tuple[str, ...]
    of: str = _EXPERIMENT
    words: str = ""


_FIRST = {
    "half_width": _Field(
        "Half width of the channel",
        ("um", "mm", "m"),
        words="25 µm in a channel that is 50 µm wide. The drawing of the mould states it; soft lithography keeps to it "
        "within about 1 %. Or measure the channel under the microscope, next to a scale.",
    ),
    "viscosity": _Field(
        "Viscosity of the liquid around",
        ("Pa s", "mPa s"),
        words="That of the liquid between capsule and walls, at the temperature of the experiment. If 0.83 or "
        "0.87 Pa s would not surprise you, write 0.85 ± 0.02.",
    ),
    "velocity": _Field(
        "Velocity of the capsule",
        ("mm/s", "um/s", "m/s"),
        _CAPSULE,
        "The distance that the capsule moves between two frames, over the time between them: 12 µm from one frame to "
        "the next at 500 frames per second are 6 mm/s. The spread over several frames shows the error. A film with its "
        "frame rate gives it by itself, in step 6.",
    ),
    "flow_rate": _Field(
        "Or flow rate in the channel",
        ("uL/min", "uL/s"),
        _CAPSULE,
        "That of the pump, with all liquids that flow through the channel. It holds for all capsules in this flow, "
        "and needs no velocity.",
    ),
    "frame_rate": _Field(
        "Frame rate of films", ("Hz", "1/s"), words="That of the camera, not that at which a film is shown."
    ),
}
_FURTHER = {
    "viscous_tension": _Field("Viscosity times mean velocity of the flow, where neither is known", ("mN/m", "N/m")),
    "exposure": _Field("Exposure of a picture", ("us", "ms", "s")),
    "density": _Field("Density of the liquid", ("kg/m^3", "g/cm^3")),
    "membrane_thickness": _Field("Thickness of the membrane", ("um", "nm", "m")),
    "pixel_aspect": _Field("Height of a pixel over its width", (), _CAMERA),
    "distortion": _Field("Distortion of the lens", (), _CAMERA),
    "taper": _Field("Taper along the channel", (), _CAMERA),
}
_FIELDS = _FIRST | _FURTHER
_MOST_TOML = 2**16  # bytes


class ChannelStep:
    """Form of the experiment and of the velocity; the function is called after each change."""

    def __init__(self, desk: Desk, changed: Callable[[], Any]) -> None:
        self.desk, self._changed = desk, changed
        with step("3. Channel, liquid, velocity"):
            ui.label("Each with its standard error: what is not known exactly makes the answer wider.")
            sections = {"square": "square", "circular": "circular"}
            self._section = choice("Cross-section", sections, "square", on_change=self._read)
            self.fields = {name: self._field(name, about) for name, about in _FIRST.items()}
            viscosity_helper(self.fields["viscosity"])
            with ui.expansion("Camera and further numbers"):
                for name, about in _FURTHER.items():
                    if name == "pixel_aspect":
                        ui.label("Geometry of the camera, if a calibration tells it:")
                    self.fields[name] = self._field(name, about)
            ui.label("A file of an earlier experiment (experiment.toml) fills the form:")
            self._upload = upload("experiment.toml", [".toml"], self._file_given, "experiment")
            self._message = notice("bench-message")

    def _field(self, name: str, about: _Field) -> QuantityField:
        known = {"velocity": "capsule_velocity"}.get(name, name)
        return QuantityField(about.label, about.units, self._read, name=known, words=about.words)

    @property
    def complete(self) -> bool:
        """True if the experiment can be written and a velocity or a flow rate is given, or mu U in their place."""
        return bool(self.desk.experiment) and not self._message.text

    @property
    def width(self) -> float:
        """Width of the channel in micrometres, 0 where it is not known."""
        with contextlib.suppress(InputError):
            return 2e6 * Quantity.of_text(self.fields["half_width"].text, "half_width", where="", key="").mean
        return 0.0

    def fill(self, texts: Mapping[str, str]) -> None:
        """Fill some of the fields in, and clear the others."""
        self._section.value = texts.get("cross_section", "square")
        for name, field in self.fields.items():
            field.text = str(texts.get(name, ""))

    def _of(self, what: str) -> dict[str, str]:
        return {name: self.fields[name].text for name, about in _FIELDS.items() if about.of == what}

    def _read(self) -> None:
        """Take over what the form states, and say what is missing."""
        experiment, camera, capsule = map(self._of, (_EXPERIMENT, _CAMERA, _CAPSULE))
        self.desk.experiment = {"cross_section": self._section.value, **experiment, "camera": camera}
        for name, text in capsule.items():
            setattr(self.desk.stated, name, "" if experiment["viscous_tension"] else text)  # which stands for them
        moves = any(capsule.values()) or experiment["viscous_tension"]
        no_speed = "" if moves else "The velocity of the capsule is missing, or the flow rate."
        self._message.text = self.desk.keep() or no_speed
        self._changed()

    async def _file_given(self, event: events.UploadEventArguments) -> None:
        self._upload.reset()
        try:
            if event.file.size() > _MOST_TOML:
                raise ValueError("a file of this size is none")
            stated = tomllib.loads(await event.file.text())
            camera = stated.pop("camera", {})
            section = {"cross_section": stated.pop("cross_section", stated.pop("section", "square"))}
            unknown = sorted((stated.keys() - self._of(_EXPERIMENT)) | (camera.keys() - self._of(_CAMERA)))
            if unknown:
                raise ValueError(f"the form has no field for {', '.join(unknown)}")
            self.fill({**self._of(_CAPSULE), **section, **stated, **camera})
        except (ValueError, AttributeError, RecursionError) as error:
            self._message.text = f"Expected the file of an experiment: {error}"
            return
        self._read()


# The helper for the viscosity: a mixture of water and glycerol, a silicone oil, or methylcellulose in saline


class _Liquid(NamedTuple):
    """A liquid of the helper: its fields, the function of their texts, the formula's own error, and what to know."""

    fields: tuple[tuple[str, tuple[str, ...]], ...]
    viscosity: Callable[..., Quantity]
    error: float
    source: str
    note: str


_DEGREES = "Temperature in °C", ()
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
}
for _share in liquids.MEDIA:
    _LIQUIDS[f"methylcellulose {_share} in saline"] = _Liquid(
        (_DEGREES, ("Flow rate of the liquid", ("uL/s", "uL/min")), ("Half width of its channel", ("um", "mm"))),
        partial(liquids.methylcellulose, _share),
        liquids.MEDIUM_ERROR,
        liquids.MEDIUM_SOURCE,
        "It is that at the shear rate of the wall; nearer to the axis it is more. The model is that of a liquid "
        "without shear thinning.",
    )


def viscosity_helper(target: QuantityField) -> None:
    """Show the helper, which fills a field."""
    with ui.expansion("Viscosity of a known liquid"):
        ui.label("A rheometer's value with its error, typed in above, is better.")
        chosen = choice("Liquid", list(_LIQUIDS), next(iter(_LIQUIDS)))
        for name, liquid in _LIQUIDS.items():
            with ui.column().classes("bench-result") as shown:
                _form(liquid, target)
            shown.bind_visibility_from(chosen, "value", value=name)


def _form(liquid: _Liquid, target: QuantityField) -> None:
    """Show the fields of a liquid, and the button that fills the viscosity in."""
    fields = [QuantityField(*about) for about in liquid.fields]
    button("Use this viscosity", lambda: fill())
    words = ui.label().classes("bench-told")

    def fill() -> None:
        try:
            viscosity = liquid.viscosity(*(field.text for field in fields))
        except CapsbayesError as error:
            words.text = page_words(error)
            return
        target.text = f"{viscosity.value:.4g} +/- {viscosity.error:.2g} Pa s"
        of_formula = f"of which {liquid.error:.0%} is the error of the formula ({liquid.source})"
        words.text = f"{viscosity.value:.4g} ± {viscosity.error:.2g} Pa s, {of_formula}. {liquid.note}"
