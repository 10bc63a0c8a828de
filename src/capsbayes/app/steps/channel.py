"""Step three: channel, liquid, camera and velocity, as the file of the experiment states them."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from typing import Any

from nicegui import events, ui

from capsbayes.app.desk import Desk
from capsbayes.app.fields import QuantityField
from capsbayes.app.steps.liquids import viscosity_helper

_SECTIONS = {"square": "square", "circular": "circular"}
_FIELDS: dict[str, tuple[str, tuple[str, ...]]] = {
    "half_width": ("Half width of the channel", ("um", "mm", "m")),
    "viscosity": ("Viscosity of the liquid around", ("Pa s", "mPa s")),
}
_RARE: dict[str, tuple[str, tuple[str, ...]]] = {
    "viscous_tension": ("Viscosity times mean velocity of the flow, where neither is known", ("mN/m", "N/m")),
    "frame_rate": ("Frame rate of films", ("Hz", "1/s")),
    "exposure": ("Exposure of a picture", ("us", "ms", "s")),
    "density": ("Density of the liquid", ("kg/m^3", "g/cm^3")),
    "membrane_thickness": ("Thickness of the membrane", ("um", "nm", "m")),
}
_CAMERA = {
    "pixel_aspect": "Height of a pixel over its width",
    "distortion": "Distortion of the lens",
    "taper": "Taper along the channel",
}
_MOST_TOML = 2**16  # bytes


class ChannelStep:
    """Form of the experiment and of the velocity.

    Parameters
    ----------
    desk : Desk
    changed : function
        Called after each change, with True if everything needed is stated.
    """

    def __init__(self, desk: Desk, changed: Callable[[], Any]) -> None:
        self.desk, self._changed = desk, changed
        with ui.card().classes("bench-step"):
            ui.html("<h2>3. Channel, liquid, velocity</h2>", sanitize=False)
            ui.label("Each with its standard error: what is not known exactly makes the answer wider.")
            self._section = ui.select(_SECTIONS, label="Cross-section", value="square", on_change=self._read)
            self._section.props("dense outlined").classes("bench-choice")
            self._fields = {key: QuantityField(*about, self._read) for key, about in _FIELDS.items()}
            self._velocity = QuantityField("Velocity of the capsule", ("mm/s", "um/s", "m/s"), self._read)
            self._rate = QuantityField("Or flow rate in the channel", ("uL/min", "uL/s"), self._read)
            viscosity_helper(self._fields["viscosity"])
            with ui.expansion("Camera and further numbers"):
                self._fields |= {key: QuantityField(*about, self._read) for key, about in _RARE.items()}
                ui.label("Geometry of the camera, if a calibration tells it:")
                self._camera = {key: QuantityField(label, (), self._read) for key, label in _CAMERA.items()}
            ui.label("A file of an earlier experiment (experiment.toml) fills the form:")
            upload = ui.upload(label="experiment.toml", auto_upload=True, on_upload=self._file_given)
            upload.props('accept=".toml" flat bordered').classes("bench-upload").mark("experiment")
            self._upload = upload
            self._message = ui.label().classes("bench-message").props('role="status"')

    @property
    def complete(self) -> bool:
        """True if the experiment can be written and a velocity or a flow rate is given, or mu U in their place."""
        return not self._message.text and bool(self._velocity.text or self._rate.text or self._tension)

    @property
    def _tension(self) -> str:
        """The product mu U, with which a velocity is neither needed nor used."""
        return self._fields["viscous_tension"].text

    def forget_velocity(self) -> None:
        """Clear the velocity, which was that of an earlier capsule."""
        self._velocity.text = ""

    def _read(self) -> None:
        """Take over what the form states, and say what is missing."""
        camera = {key: field.text for key, field in self._camera.items()}
        self.desk.experiment = {
            "cross_section": self._section.value,
            **{key: field.text for key, field in self._fields.items()},
            "camera": camera,
        }
        self.desk.stated.velocity = "" if self._tension else self._velocity.text
        self.desk.stated.flow_rate = "" if self._tension else self._rate.text
        self._message.text = self.desk.keep_experiment()
        if not self._message.text and not (self._velocity.text or self._rate.text or self._tension):
            self._message.text = "The velocity of the capsule is missing, or the flow rate."
        self._changed()

    async def _file_given(self, event: events.UploadEventArguments) -> None:
        self._upload.reset()
        try:
            if event.file.size() > _MOST_TOML:
                raise ValueError("a file of this size is none")
            stated = tomllib.loads(await event.file.text())
            camera = stated.pop("camera", {})
            self._section.value = stated.pop("cross_section", stated.pop("section", "square"))
            unknown = [key for key in stated if key not in self._fields] + [key for key in camera if key not in _CAMERA]
            if unknown:
                raise ValueError(f"the form has no field for {', '.join(unknown)}")
            for key, field in self._fields.items():
                field.text = str(stated.get(key, ""))
            for key, field in self._camera.items():
                field.text = str(camera.get(key, ""))
        except (ValueError, AttributeError, RecursionError) as error:
            self._message.text = f"Expected the file of an experiment: {error}"
            return
        self._read()
