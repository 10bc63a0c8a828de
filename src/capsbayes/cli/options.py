"""Options of the commands, each declared once."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from capsbayes.cli.paths import Reads, Writes
from capsbayes.errors import InputError

if TYPE_CHECKING:
    from capsbayes.experiment import Experiment
    from capsbayes.infer import Membrane, Prior
    from capsbayes.measurement import Measurement
    from capsbayes.model import ForwardModel
    from capsbayes.physics.load import BendingEnergy
    from capsbayes.plan import LabErrors
    from capsbayes.quantity import Quantity
    from capsbayes.surrogate import EffectSurrogate, Surrogate

# results
Seed = Annotated[int, typer.Option(min=0, help="Seed of the random numbers; it is stored in the results.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]

# what is measured, and where
CapsuleFile = Annotated[
    Path,
    typer.Argument(help="TOML file of the capsule: lengths, velocity and the name of its experiment's file."),
    Reads(),
]
ExperimentFile = Annotated[
    Path | None,
    typer.Option(help="TOML file of the experiment; default: the file that the measurement names."),
    Reads(),
]
Velocity = Annotated[str | None, typer.Option(help="Velocity of the capsule in a picture, as '6.20 +/- 0.06 mm/s'.")]
FlowRate = Annotated[
    str | None,
    typer.Option(help="Flow rate in the channel, as '0.56 +/- 0.01 uL/min': U = Q/A then follows without a velocity."),
]
SharedVelocity = Annotated[
    str | None,
    typer.Option(
        help="Velocity that several capsules share, as '4.86 +/- 0.30 mm/s'; the error is its spread between capsules."
    ),
]
Background = Annotated[
    Path | None, typer.Option(help="Picture of the empty channel, to go with a picture or a film."), Reads()
]
Flow = Annotated[
    str | None, typer.Option(help="Direction of the flow in a picture, right or left; default: found from the shape.")
]


_BY_HAND = ("walls", "wall_error", "pixel_size", "axis", "crop", "erase", "contrast", "rotate")
BY_HAND = {name: f"--{name.replace('_', '-')}" for name in _BY_HAND}
"""Options of `by_hand_of` by the names of the fields of `ByHand`."""


def by_hand_of(
    walls: Annotated[
        str | None,
        typer.Option(
            help='Rows of the two walls in px, as "12.5, 187.0"; of tilted ones, of each at the left and the right '
            'border, as "12.5 15.0, 187.0 189.5"; default: found in the picture.'
        ),
    ] = None,
    wall_error: Annotated[
        str | None, typer.Option(help='Standard error of either wall of --walls; default: "1 px".')
    ] = None,
    pixel_size: Annotated[
        str | None,
        typer.Option(
            help='Size of a pixel, as "0.340 +/- 0.003 um": no walls are sought in the picture, and l in px is the '
            "half width over it; of a contour or an .rtdc file, its scale."
        ),
    ] = None,
    axis: Annotated[
        str | None,
        typer.Option(
            help='Row of the axis of the channel in px, as "99.5", or at the left and the right border, as "98 101", '
            "with --pixel-size; default: the middle row."
        ),
    ] = None,
    crop: Annotated[
        str | None,
        typer.Option(help='Part to analyse: left column, upper row, width and height in px, as "40, 0, 220, 200".'),
    ] = None,
    erase: Annotated[
        str | None,
        typer.Option(
            help="Boxes within which the outline of the capsule is wrong, as where dirt touches it: left column, upper "
            'row, width and height in px of each, as "40, 0, 22, 20; 90, 60, 12, 9". The rest of it is used.'
        ),
    ] = None,
    contrast: Annotated[
        str | None,
        typer.Option(help="Capsule and walls compared with the liquid, dark or bright; default: found in the picture."),
    ] = None,
    rotate: Annotated[
        str | None,
        typer.Option(
            help="Turn picture and background clockwise by 90, 180 or 270 degrees first: the flow must run along the "
            "rows. All places in px are those of the turned picture."
        ),
    ] = None,
) -> Any:
    """Return what is stated of a picture by hand, None if nothing; each is an option of commands that measure pictures.

    Raises
    ------
    InputError
        Naming what is wrong.
    """
    stated = (walls, wall_error, pixel_size, axis, crop, erase, contrast, rotate)
    if all(text is None for text in stated):
        return None
    from capsbayes.image.by_hand import ByHand  # slow to import

    return ByHand(**dict(zip(_BY_HAND, stated, strict=True)))


# the model
DatabaseName = Annotated[str, typer.Argument(help="Name of a shipped database, or path of a .nc file."), Reads()]
ModelName = Annotated[
    str | None,
    typer.Option(
        "--database",
        help="Name of a shipped database, or path of a .nc file; default: neo-Hookean, with the experiment's channel.",
    ),
    Reads(),
]

MembraneKnown = Annotated[
    list[str] | None,
    typer.Option(
        "--membrane",
        help="What is known of the membrane, in place of --database: its law (unknown, neo-Hookean, Blatz-Ko or "
        "Skalak), or NAME=TEXT, as pre_inflation='0 .. 0.02', with one of the names pre_inflation, bending, "
        "strain_hardening, hardening (C of Skalak's law), area_dilation_modulus or membrane_thickness; may be given "
        "several times.",
    ),
]

Guess = Annotated[
    list[str] | None,
    typer.Option(
        help="What is expected of the membrane where it is not known, in the words of --membrane, as "
        "pre_inflation=0.03 or neo-Hookean; default: the middles of the priors; may be given several times."
    ),
]

ScaleError = Annotated[
    float,
    typer.Option(min=0.0, max=0.2, help="Relative standard error of all lengths together, as by the pixel size."),
]

Priors = Annotated[
    list[str] | None,
    typer.Option(
        "--prior",
        help="Prior NAME=TEXT, as capsule_radius='20 .. 30 um', of capsule_radius, surface_shear_modulus or a further "
        "coordinate of the database, as pre_inflation; other texts: '50 +/- 10 mN/m', 'log-uniform 1 .. 1000 mN/m', "
        "'log-normal 50 +/- 10 mN/m'; may be given several times.",
    ),
]

# long work
Scheduler = Annotated[
    str | None,
    typer.Option(
        help="Address of a dask cluster that sees the same files, as tcp://host:port; default: this machine. It needs "
        "the extra cluster."
    ),
]
Workers = Annotated[
    int | None, typer.Option(min=1, max=1024, help="Worker processes on this machine; default: one per core.")
]

# a simulated capsule
CapillaryNumber = Annotated[float, typer.Option("--ca", help="Capillary number mu U / G_s.")]
SizeRatio = Annotated[float, typer.Option(help="Size ratio a/l: radius at rest over the half width of the channel.")]
Plot = Annotated[
    Path | None, typer.Option(help="Draw the shape in a .png, .pdf or .svg file."), Writes(".png", ".pdf", ".svg")
]


def effort_of(
    walkers: Annotated[int | None, typer.Option(min=8, help="Of each ensemble of emcee; default: 64.")] = None,
    steps: Annotated[
        int | None, typer.Option(min=50, help="Of emcee before its checks are made the first time; default: 450.")
    ] = None,
    ensembles: Annotated[
        int | None, typer.Option(min=4, help="Independent ensembles of emcee, compared with each other; default: 4.")
    ] = None,
    most_steps: Annotated[
        int | None, typer.Option(min=50, help="Of emcee, at which it ends in any case; default: 10000.")
    ] = None,
) -> Any:
    """Return how much emcee samples, None if nothing is stated; each is an option of `identify`.

    Raises
    ------
    InputError
        If the steps are more than the most.
    """
    stated = {"walkers": walkers, "steps": steps, "ensembles": ensembles, "budget": most_steps}
    given = {name: value for name, value in stated.items() if value is not None}
    if not given:
        return None
    from capsbayes.infer.sampling import Effort

    effort = Effort(**given)
    if effort.steps > effort.budget:
        raise InputError("identify", "--steps", f"at most --most-steps, {effort.budget}", str(effort.steps))
    return effort


def simulator_of(
    law: Annotated[
        str,
        typer.Option(
            help="Membrane law with its parameters, as skalak:hardening=1 (several are separated by commas): "
            "neo-hookean; skalak (hardening); hooke (poisson_ratio); strain-hardening (strain_hardening); "
            "hooke-share (hooke_share); general (area_dilation_modulus and strain_hardening); evans-skalak "
            "(area_dilation_modulus)."
        ),
    ] = "neo-hookean",
    cross_section: Annotated[
        str, typer.Option(help="Cross-section of the channel: square, rectangular or circular.")
    ] = "square",
    corner_radius: Annotated[float, typer.Option(help="Radius of the corners of a square channel, over l.")] = 0.0,
    section_aspect: Annotated[float, typer.Option(help="Depth of the cross-section over the width seen, b/l.")] = 1.0,
    refinement: Annotated[
        int, typer.Option(help="Subdivisions n of an edge of the mesh: 8 is quick, 12 is fit to publish.")
    ] = 8,
    bending: Annotated[float, typer.Option(help="Bending stiffness B over G_s a^2.")] = 2e-4,
    pre_inflation: Annotated[float, typer.Option(help="Osmotic pre-inflation alpha of the radius.")] = 0.0,
    rest_aspect: Annotated[float, typer.Option(help="Axis at rest along the flow over the axis across it.")] = 1.0,
    bending_energy: Annotated[
        str, typer.Option(help="What bending costs: the change of curvature, or the displacement from rest.")
    ] = "displacement",
) -> Any:
    """Return the simulator with these settings, each of which is an option of the commands that simulate.

    Raises
    ------
    InputError
        Naming the option that is wrong.
    """
    from capsbayes.physics.membrane import law_named

    membrane = law_named(law)
    from capsbayes.physics.simulator import Simulator

    return Simulator(
        law=membrane,
        cross_section=cross_section,
        refinement=refinement,
        bending=bending,
        pre_inflation=pre_inflation,
        corner_radius=corner_radius,
        section_aspect=section_aspect,
        rest_aspect=rest_aspect,
        bending_energy=cast("BendingEnergy", bending_energy),  # checked by the simulator
    )


def lab_of(
    like: Annotated[
        Path | None, typer.Option(help="TOML file of a capsule that was measured with the same errors."), Reads()
    ] = None,
    experiment: ExperimentFile = None,
    extent_error: Annotated[float | None, typer.Option(help="Standard error of L_z, over l.")] = None,
    length_error: Annotated[
        float | None, typer.Option(help="Standard error of L_a, over l; omit it where the rear is not seen.")
    ] = None,
    velocity_error: Annotated[float | None, typer.Option(help="Standard error of v_o, over v_o.")] = None,
    rate_error: Annotated[
        float | None, typer.Option(help="Standard error of the flow rate, over it; omit it where it is not known.")
    ] = None,
    outline_error: Annotated[
        float | None, typer.Option(help="Standard error along outlines, over l; omit it where none are measured.")
    ] = None,
    outline_correlation: Annotated[
        float | None, typer.Option(help="Length along an outline over which its errors are correlated, over l.")
    ] = None,
) -> Any:
    """Return the errors of a lab, its experiment, and what is stated of the membrane of a measured capsule.

    The errors are those of that capsule, or those that are stated.

    Raises
    ------
    InputError
        Naming the option that is wrong or missing.
    """
    from capsbayes.experiment import Experiment
    from capsbayes.infer import Membrane
    from capsbayes.measurement import Measurement, OutlineNoise
    from capsbayes.plan import LabErrors

    outline = {"--outline-error": outline_error, "--outline-correlation": outline_correlation}
    stated = {"--extent-error": extent_error, "--length-error": length_error, "--velocity-error": velocity_error}
    stated |= {"--rate-error": rate_error, **outline}
    if like is not None:
        for option, value in stated.items():
            if value is not None:
                raise InputError("sensitivity", option, "no such option together with --like", f"{value:g}")
        measurement = Measurement.read(like)
        return LabErrors.of(measurement), named_experiment(measurement, experiment), Membrane.read(like)
    if experiment is None or extent_error is None or velocity_error is None:
        given = ", ".join(name for name, value in stated.items() if value is not None) or "none of them"
        expected = "--like CAPSULE, or --experiment with --extent-error and --velocity-error"
        raise InputError("sensitivity", "errors", expected, given if experiment is None else f"--experiment, {given}")
    noise = None
    if outline_error is not None or outline_correlation is not None:
        if outline_error is None or outline_correlation is None:
            missing = next(name for name, value in outline.items() if value is None)
            raise InputError("sensitivity", missing, "one, as the errors of an outline need both", "none")
        noise = OutlineNoise(outline_error, outline_correlation)
    errors = LabErrors(extent_error, velocity_error, length_error, outline=noise, flow_rate=rate_error)
    return errors, Experiment.read(experiment), None


def lengths_alone(errors: LabErrors) -> LabErrors:
    """Return errors without those of outlines and of the flow rate, of which it is said that they do not count."""
    if errors.outline is not None:
        typer.echo("The widths are those of lengths alone; outlines would make them narrower.", err=True)
    return replace(errors, outline=None, flow_rate=None)


def with_options_of(made: Callable[..., Any], name: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command the options of a function in place of one parameter, whose value is what the function returns."""
    options = inspect.signature(made, eval_str=True).parameters

    def decorated(command: Callable[..., None]) -> Callable[..., None]:
        own = inspect.signature(command, eval_str=True)
        parameters = [
            new
            for parameter in own.parameters.values()
            for new in (options.values() if parameter.name == name else [parameter])
        ]
        ordered = sorted(parameters, key=lambda parameter: parameter.default is not inspect.Parameter.empty)

        @functools.wraps(command)
        def run(**given: Any) -> None:
            value = made(**{option: given.pop(option) for option in options})
            command(**{name: value}, **given)

        run.__signature__ = own.replace(parameters=ordered)  # type: ignore[attr-defined]
        return run

    return decorated


def choose(command: str, option: str, name: str, known: Mapping[str, Any]) -> Any:
    """Return the entry of `known` with this name; an unknown name is refused with a list of the known ones."""
    if name not in known:
        raise InputError(command, option, f"one of {', '.join(known)}", repr(name))
    return known[name]


_SPEEDS = {
    "--velocity": ("capsule_velocity", "m/s", "6.20 +/- 0.06 mm/s"),
    "--shared-velocity": ("capsule_velocity", "m/s", "4.86 +/- 0.30 mm/s"),
    "--flow-rate": ("flow_rate", "m^3/s", "0.56 +/- 0.01 uL/min"),
}


def speeds_of(
    stated: Mapping[str, str | None], experiment: Experiment | None, several: str = ""
) -> dict[str, Quantity]:
    """Return velocity and flow rate by name, for one capsule or for `several`, as "3 events"; refuse what is missing.

    Of one capsule, one of both is needed unless the experiment states mu U.
    """
    from capsbayes.quantity import Quantity

    given = {option: text for option, text in stated.items() if text is not None}
    tension = experiment is not None and experiment.viscous_tension is not None
    if not (given or several or tension):
        raise InputError("--velocity", "", f'a text like "{_SPEEDS["--velocity"][2]}", or --flow-rate', "nothing")
    found = {}
    for option, text in given.items():
        name, unit, example = _SPEEDS[option]
        if tension:
            raise InputError(option, "", "none: the experiment states viscous_tension, mu U", repr(text))
        if option == "--velocity" and several:
            advice = "give --flow-rate, which needs no velocity, or --shared-velocity with the spread between capsules"
            raise InputError(option, "", "one capsule, as each has a velocity of its own", several, advice)
        if name in found:
            raise InputError(option, "", "one velocity", "--velocity too")
        read = Quantity.read(text, where=option, key="", units=(unit,), example=example)
        if read.known or read.shape != "normal":
            raise InputError(option, "", f'a standard error, as in "{example}"', repr(text))
        found[name] = Quantity.of(read, name, where=option, key="")
    return found


def prior_texts(priors: list[str] | None) -> dict[str, str]:
    """Return the name and the text of each option ``--prior NAME=TEXT``."""
    from capsbayes.parameters import COORDINATES

    texts, names = {}, ("surface_shear_modulus", "capsule_radius", *COORDINATES)
    for prior in priors or []:
        name, equals, text = prior.partition("=")
        if name not in names or not equals:
            raise InputError("--prior", "", f"NAME=TEXT with one of the names {', '.join(names)}", repr(prior))
        texts[name] = text
    return texts


def prior_of(priors: list[str] | None) -> Prior:
    """Return the default priors, changed by the options ``--prior``."""
    from capsbayes.infer import Prior

    return Prior().with_texts(prior_texts(priors), where="--prior")


def named_experiment(measurement: Measurement, experiment: Path | None) -> Experiment:
    """Return the experiment of a measurement: of the option ``--experiment``, or of the file that it names."""
    from capsbayes.experiment import Experiment

    path = experiment or measurement.experiment_file
    if path is None:
        raise InputError(
            measurement.source, "experiment", "the name of a file", "nothing", "name it, or use --experiment"
        )
    return Experiment.read(path)


def named_model(database: str | None, cross_section: str, view: str | None = None) -> Surrogate | EffectSurrogate:
    """Return the model of the option ``--database``; default: neo-Hookean, with this cross-section."""
    from capsbayes.measurement import MID_PLANE
    from capsbayes.surrogate import Surrogate

    return Surrogate.open(database or f"{cross_section}-neo-hookean", view=view or MID_PLANE)


def membrane_of(stated: Membrane | None, options: list[str] | None, option_name: str = "--membrane") -> Membrane | None:
    """Return what a capsule's file states of its membrane, changed by the options ``--membrane``; None if neither does.

    Raises
    ------
    InputError
        On an option that is neither a law nor NAME=TEXT.
    """
    from capsbayes.infer.prior import KEYS, Membrane

    texts = {}
    for option in options or []:
        name, equals, text = option.partition("=")
        if equals and name not in ("law", *KEYS):
            raise InputError(
                option_name, "", f"a law, or NAME=TEXT with one of the names {', '.join(KEYS)}", repr(option)
            )
        texts[name if equals else "law"] = text if equals else option
    return (stated or Membrane()).with_texts(texts, where=option_name) if texts else stated


def capsule_model(
    database: str | None, membrane: Membrane | None, cross_section: str, view: str | None
) -> ForwardModel:
    """Return the model over the membrane if something is said of it, or that of ``--database``.

    Raises
    ------
    InputError
        If both are given.
    """
    from capsbayes.measurement import MID_PLANE
    from capsbayes.surrogate import MembraneSurrogate

    if membrane is None:
        return named_model(database, cross_section, view)
    if database is not None:
        raise InputError("identify", "--membrane (or [membrane]), --database", "one of the two", "both")
    return MembraneSurrogate.open(cross_section, view=view or MID_PLANE)
