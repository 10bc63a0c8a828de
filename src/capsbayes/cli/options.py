"""Options of several commands, each declared once, and what they stand for."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import capsbayes as cb
from capsbayes.cli.command import Input, Option, Options, Reads
from capsbayes.errors import InputError
from capsbayes.parameters import COORDINATES
from capsbayes.quantity import uncertain

if TYPE_CHECKING:
    from capsbayes.image import ByHand
    from capsbayes.model import ForwardModel
    from capsbayes.surrogate import EffectSurrogate

Seed = Annotated[int, Option("Seed of the random numbers; it is stored in the results.", min=0)]
CapsuleFile = Annotated[
    Path, Input("TOML file of the capsule: lengths, velocity and the name of its experiment's file.")
]
CapsulesFile = Annotated[Path, Input("Folder of measurement files, .csv table of lengths, or .nc file of outlines.")]
ExperimentFile = Annotated[
    Path | None, Reads("TOML file of the experiment; default: the file that the measurement names.")
]
DatabaseName = Annotated[str, Input("Name of a shipped database, or path of a .nc file.")]
ModelName = Annotated[
    str | None,
    Reads("Name of a shipped database, or path of a .nc file; default: neo-Hookean, with the experiment's channel."),
]
MembraneKnown = Annotated[
    list[str] | None,
    Option(
        "What is known of the membrane, in place of --database: its law (unknown, neo-Hookean, Blatz-Ko or "
        "Skalak), or NAME=TEXT, as pre_inflation='0 .. 0.02', with one of the names pre_inflation, bending, "
        "strain_hardening, hardening (C of Skalak's law), area_dilation_modulus or membrane_thickness; may be given "
        "several times."
    ),
]
Priors = Annotated[
    list[str] | None,
    Option(
        "Prior NAME=TEXT, as capsule_radius='20 .. 30 um', of capsule_radius, surface_shear_modulus or a further "
        "coordinate of the database, as pre_inflation; other texts: '50 +/- 10 mN/m', 'log-uniform 1 .. 1000 mN/m', "
        "'log-normal 50 +/- 10 mN/m'; may be given several times."
    ),
]
Refine = Annotated[
    int | None,
    Option(
        "Simulate up to N more states where the posterior lies and add them to the model, until its own error no "
        "longer counts. They are kept in the user's cache, and later runs begin with them.",
        min=1,
        metavar="N",
    ),
]
ScaleError = Annotated[
    float, Option("Relative standard error of all lengths together, as by the pixel size.", min=0.0, max=0.2)
]
Scheduler = Annotated[
    str | None,
    Option(
        "Address of a dask cluster that sees the same files, as tcp://host:port; default: this machine. It needs "
        "the extra cluster."
    ),
]
Workers = Annotated[int | None, Option("Worker processes on this machine; default: one per core.", min=1, max=1024)]

_SPEEDS = {
    "--velocity": ("capsule_velocity", "m/s", "6.20 +/- 0.06 mm/s"),
    "--shared-velocity": ("capsule_velocity", "m/s", "4.86 +/- 0.30 mm/s"),
    "--flow-rate": ("flow_rate", "m^3/s", "0.56 +/- 0.01 uL/min"),
}
# fields of `ByHand`
_BY_HAND = ("walls", "wall_error", "pixel_size", "axis", "crop", "erase", "contrast", "edge_offset", "rotate", "gamma")
BY_HAND = tuple(f"--{name.replace('_', '-')}" for name in _BY_HAND)


@dataclass(frozen=True)
class PictureOptions(Options):
    """How fast the capsule in a picture moves, and what else is stated of the picture."""

    velocity: Annotated[str | None, Option("Velocity of the capsule in a picture, as '6.20 +/- 0.06 mm/s'.")] = None
    flow_rate: Annotated[
        str | None,
        Option("Flow rate in the channel, as '0.56 +/- 0.01 uL/min': U = Q/A then follows without a velocity."),
    ] = None
    background: Annotated[Path | None, Reads("Picture of the empty channel, to go with a picture or a film.")] = None
    flow: Annotated[
        str | None, Option("Direction of the flow in a picture, right or left; default: found from the shape.")
    ] = None
    walls: Annotated[
        str | None,
        Option(
            'Rows of the two walls in px, as "12.5, 187.0"; of tilted ones, of each at the left and the right '
            'border, as "12.5 15.0, 187.0 189.5"; default: found in the picture.'
        ),
    ] = None
    wall_error: Annotated[str | None, Option('Standard error of either wall of --walls; default: "1 px".')] = None
    pixel_size: Annotated[
        str | None,
        Option(
            'Size of a pixel, as "0.340 +/- 0.003 um": no walls are sought in the picture, and l in px is the '
            "half width over it; of a contour or an .rtdc file, its scale."
        ),
    ] = None
    axis: Annotated[
        str | None,
        Option(
            'Row of the axis of the channel in px, as "99.5", or at the left and the right border, as "98 101", '
            "with --pixel-size; default: the middle row."
        ),
    ] = None
    crop: Annotated[
        str | None, Option('Part to analyse: left column, upper row, width and height in px, as "40, 0, 220, 200".')
    ] = None
    erase: Annotated[
        str | None,
        Option(
            "Boxes within which the outline of the capsule is wrong, as where dirt touches it: left column, upper "
            'row, width and height in px of each, as "40, 0, 22, 20; 90, 60, 12, 9". The rest of it is used.'
        ),
    ] = None
    contrast: Annotated[
        str | None, Option("Capsule and walls compared with the liquid, dark or bright; default: found in the picture.")
    ] = None
    edge_offset: Annotated[
        str | None,
        Option(
            'How far outside the located edge the true one lies, as "0.12 +/- 0.05 px", if it was measured, as by '
            "measure --target."
        ),
    ] = None
    rotate: Annotated[
        str | None,
        Option(
            "Turn picture and background clockwise by 90, 180 or 270 degrees first: the flow must run along the "
            "rows. All places in px are those of the turned picture."
        ),
    ] = None
    gamma: Annotated[
        str | None, Option('Gamma of the camera, as "2.2": its grey levels are the light to the power of 1/2.2.')
    ] = None

    def by_hand(self) -> ByHand | None:
        """Return what is stated of the picture by hand; None if nothing is."""
        stated = {name: getattr(self, name) for name in _BY_HAND}
        if all(text is None for text in stated.values()):
            return None
        from capsbayes.image.by_hand import ByHand  # slow to import

        return ByHand(**stated)

    def speeds(self, experiment: cb.Experiment | None, several: str = "") -> dict[str, cb.Quantity]:
        """Return velocity and flow rate by name, for one capsule or for `several`, as "3 events"; refuse what is wrong.

        Of one capsule, one of both is needed unless the experiment states mu U.
        """
        given = {option: text for option, text in self.given().items() if option in _SPEEDS}
        tension = experiment is not None and experiment.viscous_tension is not None
        if not (given or several or tension):
            raise InputError("--velocity", "", f'a text like "{_SPEEDS["--velocity"][2]}", or --flow-rate', "nothing")
        speeds: dict[str, cb.Quantity] = {}
        for option, text in given.items():
            name, unit, example = _SPEEDS[option]
            if tension:
                raise InputError(option, "", "none: the experiment states viscous_tension, mu U", repr(text))
            if option == "--velocity" and several:
                advice = (
                    "give --flow-rate, which needs no velocity, or --shared-velocity with the spread between capsules"
                )
                raise InputError(option, "", "one capsule, as each has a velocity of its own", several, advice)
            if name in speeds:
                raise InputError(option, "", "one velocity", "--velocity too")
            speeds[name] = uncertain(text, name, where=option, units=(unit,), example=example)
        return speeds


@dataclass(frozen=True)
class PicturesOptions(PictureOptions):
    """How fast the capsules in pictures, a film or an .rtdc file move, and what else is stated of the pictures."""

    shared_velocity: Annotated[
        str | None,
        Option(
            "Velocity that several capsules share, as '4.86 +/- 0.30 mm/s'; the error is its spread between capsules."
        ),
    ] = None


@dataclass(frozen=True)
class LabOptions(Options):
    """Errors and experiment of a lab."""

    like: Annotated[Path | None, Reads("TOML file of a capsule that was measured with the same errors.")] = None
    experiment: ExperimentFile = None
    extent_error: Annotated[float | None, Option("Standard error of L_z, over l.")] = None
    length_error: Annotated[
        float | None, Option("Standard error of L_a, over l; omit it where the rear is not seen.")
    ] = None
    velocity_error: Annotated[float | None, Option("Standard error of v_o, over v_o.")] = None
    rate_error: Annotated[
        float | None, Option("Standard error of the flow rate, over it; omit it where it is not known.")
    ] = None
    outline_error: Annotated[
        float | None, Option("Standard error along outlines, over l; omit it where none are measured.")
    ] = None
    outline_correlation: Annotated[
        float | None, Option("Length along an outline over which its errors are correlated, over l.")
    ] = None

    def read(self) -> tuple[cb.LabErrors, cb.Experiment, cb.Membrane | None]:
        """Return the errors, the experiment, and what is stated of the membrane of the capsule of ``--like``."""
        if self.like is not None:
            for option, value in self.given().items():
                if option not in ("--like", "--experiment"):
                    raise InputError("sensitivity", option, "no such option together with --like", f"{value:g}")
            measurement = cb.Measurement.read(self.like)
            experiment = named_experiment(measurement, self.experiment)
            return cb.LabErrors.of(measurement), experiment, cb.Membrane.read(self.like)
        if self.experiment is None or self.extent_error is None or self.velocity_error is None:
            expected = "--like CAPSULE, or --experiment with --extent-error and --velocity-error"
            raise InputError("sensitivity", "errors", expected, ", ".join(self.given()) or "none of them")
        known = self.extent_error, self.velocity_error, self.length_error
        errors = cb.LabErrors(*known, outline=self._noise(), flow_rate=self.rate_error)
        return errors, cb.Experiment.read(self.experiment), None

    def _noise(self) -> cb.OutlineNoise | None:
        """Return the errors of outlines, None if none are measured."""
        if self.outline_error is None and self.outline_correlation is None:
            return None
        if self.outline_error is None or self.outline_correlation is None:
            missing = "--outline-error" if self.outline_error is None else "--outline-correlation"
            raise InputError("sensitivity", missing, "one, as the errors of an outline need both", "none")
        return cb.OutlineNoise(self.outline_error, self.outline_correlation)


def lengths_alone(errors: cb.LabErrors) -> cb.LabErrors:
    """Return errors without those of outlines and of the flow rate, of which it is said that they do not count."""
    if errors.outline is not None:
        typer.echo("The widths are those of lengths alone; outlines would make them narrower.", err=True)
    return replace(errors, outline=None, flow_rate=None)


def prior_of(options: list[str] | None, stated: cb.Prior | None = None) -> cb.Prior:
    """Return the priors that a capsule's file states, or those by default, changed by the options ``--prior``."""
    texts, names = {}, ("surface_shear_modulus", "capsule_radius", *COORDINATES)
    for option in options or []:
        name, equals, text = option.partition("=")
        if name not in names or not equals:
            raise InputError("--prior", "", f"NAME=TEXT with one of the names {', '.join(names)}", repr(option))
        texts[name] = text
    return (stated or cb.Prior()).with_texts(texts, where="--prior")


def membrane_of(
    stated: cb.Membrane | None, options: list[str] | None, option_name: str = "--membrane"
) -> cb.Membrane | None:
    """Return what a file states of the membrane, changed by the options ``--membrane``; None if nothing is said."""
    from capsbayes.infer.prior import KEYS

    texts = {}
    for option in options or []:
        name, equals, text = option.partition("=")
        if equals and name not in ("law", *KEYS):
            expected = f"a law, or NAME=TEXT with one of the names {', '.join(KEYS)}"
            raise InputError(option_name, "", expected, repr(option))
        texts[name if equals else "law"] = text if equals else option
    return (stated or cb.Membrane()).with_texts(texts, where=option_name) if texts else stated


def named_experiment(measurement: cb.Measurement, experiment: Path | None) -> cb.Experiment:
    """Return the experiment of a measurement: of the option ``--experiment``, or of the file that it names."""
    return cb.Experiment.read(experiment or measurement.named_experiment("name it, or use --experiment"))


def named_model(database: str | None, cross_section: str, view: str | None = None) -> cb.Surrogate | EffectSurrogate:
    """Return the model of the option ``--database``; default: neo-Hookean, with this cross-section."""
    from capsbayes.measurement import MID_PLANE

    return cb.Surrogate.open(database or f"{cross_section}-neo-hookean", view=view or MID_PLANE)


def capsule_model(
    database: str | None, membrane: cb.Membrane | None, experiment: cb.Experiment, measurement: cb.Measurement
) -> ForwardModel:
    """Return the model over the membrane if something is said of it, or that of ``--database``; both are refused."""
    if membrane is None:
        return named_model(database, experiment.cross_section, measurement.view)
    if database is not None:
        raise InputError("identify", "--membrane (or [membrane]), --database", "one of the two", "both")
    return cb.MembraneSurrogate.open(experiment.cross_section, view=measurement.view)
