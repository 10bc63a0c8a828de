"""``capsbayes sensitivity``: the share of each input in the interval of a capsule, and where a lab should measure."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import capsbayes as cb
from capsbayes.cli.command import Option, Options, command, results
from capsbayes.cli.options import (
    CapsuleFile,
    ExperimentFile,
    LabOptions,
    MembraneKnown,
    ModelName,
    Priors,
    ScaleError,
    Seed,
    capsule_model,
    lengths_alone,
    membrane_of,
    named_experiment,
    named_model,
    prior_of,
)
from capsbayes.cli.output import conclude, model_words, table_file, waiting
from capsbayes.errors import InputError
from capsbayes.files.output_file import write_dataset
from capsbayes.report.files import Writer, figure_file, json_file

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from capsbayes.plan import FlowDesign, FlowPoint, SimulatedWidths, SobolStudy
    from capsbayes.plan.membrane import MembraneFlowDesign

    Floats = NDArray[np.float64]
    Parts = Sequence[str | pd.DataFrame]

_CAPSULES, _FLOWS = 40, 4  # of a batch that is to tell its membrane
_MOST_POINTS = 200  # of a map along an axis


@dataclass(frozen=True)
class UnknownMembraneOptions(Options):
    """What is known and expected of a membrane that is not known."""

    membrane: MembraneKnown = None
    guess: Annotated[
        list[str] | None,
        Option(
            "What is expected of the membrane where it is not known, in the words of --membrane, as "
            "pre_inflation=0.03 or neo-Hookean; default: the middles of the priors; may be given several times."
        ),
    ] = None
    prior: Priors = None

    def expected(self, sheet: cb.Membrane) -> dict[str, Any]:
        """Return what is known of the membrane, what is expected of it, and the priors."""
        guess = membrane_of(None, self.guess, "--guess")
        return {"membrane": sheet, "guess": guess, "prior": prior_of(self.prior)}

    def check(self, command: str, sheet: cb.Membrane | None, of_law: Mapping[str, object]) -> None:
        """Refuse these options where the law is known, and those of a known law where it is not."""
        for option, value in (self.given() if sheet is None else of_law).items():
            if sheet is None:
                raise InputError(command, option, "--membrane with it", f"{value} without")
            if value is not None:
                raise InputError(command, option, "no such option with the membrane unknown", str(value))


@dataclass(frozen=True)
class PlannedBatchOptions(UnknownMembraneOptions):
    """A batch that is to tell its membrane."""

    capsules: Annotated[int | None, Option(f"Capsules of the batch; default: {_CAPSULES}.", min=1, max=100_000)] = None
    same_capsule: Annotated[
        bool, Option("One capsule is filmed at all flow rates, in place of a batch.", "--same-capsule")
    ] = False
    flows: Annotated[int | None, Option(f"Most flow rates to film a batch at; default: {_FLOWS}.", min=1, max=5)] = None
    scale_error: ScaleError = 0.0
    mean_velocity: Annotated[
        list[str] | None,
        Option('Mean velocity of a flow to film a batch at, as "2 mm/s"; default: the best are sought.'),
    ] = None

    def velocities(self) -> list[float]:
        """Return the stated mean velocities in m/s."""
        key, velocities = "--mean-velocity", []
        for text in self.mean_velocity or []:
            speed = cb.Quantity.read(text, where=key, key="", units=("m/s",), example="2 mm/s")
            if not speed.known:
                raise InputError(key, "", 'a number without an error, as "2 mm/s"', str(speed))
            velocities.append(speed.value)
        return velocities


@command
def budget(
    capsule: CapsuleFile,
    out: Annotated[Path | None, results("budget.json", "budget.csv", "budget.png")] = None,
    experiment: ExperimentFile = None,
    database: ModelName = None,
    membrane: MembraneKnown = None,
    seed: Seed = 1,
) -> None:
    """Compute the share of the variance of G_s and a due to each input, and how both change with it.

    With --membrane, what is not known of the membrane has shares too.

    Exit status: 0 done, 1 the posterior cannot be used (the status says why), 2 bad input.
    """
    from capsbayes.report import budget_figure
    from capsbayes.report.plan import budget_table
    from capsbayes.run import resumable

    measurement = cb.Measurement.read(capsule)
    sheet = membrane_of(cb.Membrane.read(capsule), membrane)
    known = named_experiment(measurement, experiment)
    model, prior = capsule_model(database, sheet, known, measurement), cb.Prior.read(capsule)
    if sheet is not None:
        model, prior = sheet.applied(model, prior)
    with resumable(out):
        with waiting("Computing the budget ..."):
            posterior = cb.identify(measurement, model, known, engine="quadrature", seed=seed, prior=prior)
            shares = cb.error_budget(posterior, model)
        result = {**shares.as_dict(), "seed": seed}
        files: dict[str, Writer] = {
            "budget.json": json_file(result),
            "budget.csv": table_file(shares.table(), index_label="input"),
            "budget.png": figure_file(lambda: budget_figure(shares)),
        }
        parts: Parts = [budget_table(shares), *shares.notes, model_words(shares.model_name, shares.model_sha256, seed)]
        conclude(result, parts, files, out=out, status=shares.status)


@command
def sobol(
    capsule: CapsuleFile,
    ranges: Annotated[
        list[str] | None,
        Option(
            "Range of an input, as viscosity='0.80 .. 0.90 Pa s' (each value as likely) or "
            "axial_extent='2.14 +/- 0.02'; default: mean and error of the capsule and its experiment.",
            "--range",
        ),
    ] = None,
    samples: Annotated[int, Option("Groups of samples, a power of two.", min=8, max=2**16)] = 1024,
    out: Annotated[Path | None, results("sobol.json", "sobol.png")] = None,
    experiment: ExperimentFile = None,
    database: ModelName = None,
    seed: Seed = 1,
) -> None:
    """Compute the Sobol indices of the deterministic answer (G_s, a, Ca, a/l) over ranges of the inputs.

    Exit status: 0 done, 1 the ranges leave the database, 2 bad input.
    """
    from capsbayes.report import sobol_figure
    from capsbayes.report.plan import sobol_table
    from capsbayes.run import resumable

    stated = _ranges(ranges or [])
    measurement = cb.Measurement.read(capsule)
    known = named_experiment(measurement, experiment)
    model = named_model(database, known.cross_section)
    with resumable(out):
        with waiting("Answering the samples ..."):
            study = cb.sobol_indices(measurement, model, known, seed=seed, ranges=stated, samples=samples)
        files: dict[str, Writer] = {
            "sobol.json": json_file(study.as_dict()),
            "sobol.png": figure_file(lambda: sobol_figure(study)),
        }
        model_line = model_words(study.model_name, study.model_sha256, study.seed)
        parts: Parts = [sobol_table(study), *_sobol_lines(study), model_line]
        conclude(study.as_dict(), parts, files, out=out, status=study.status)


def _ranges(texts: list[str]) -> dict[str, cb.Quantity]:
    """Return the range of each option ``--range NAME=TEXT``."""
    from capsbayes.plan import varied_range

    ranges = {}
    for text in texts:
        name, equals, stated = text.partition("=")
        if not equals:
            raise InputError("--range", "", "NAME=RANGE", repr(text))
        ranges[name.strip()] = varied_range(stated, name.strip(), where="--range")
    return ranges


def _sobol_lines(study: SobolStudy) -> list[str]:
    lines = [f"{study.samples} samples in {study.groups} groups."]
    if study.outside:
        share = study.outside / study.samples
        lines.append(
            f"{study.outside} of them ({share:.1%}) have a shape that no capsule of the database has; they were given "
            f"the answer of the nearest shape. Without their groups the indices of G_s and a change by at most "
            f"{study.change:.3f}."
        )
    return [*lines, *study.notes]


@command
def identifiability(
    lab: LabOptions,
    out: Annotated[Path | None, results("map.nc", "map.json", "map.png", "map-radius.png")] = None,
    database: ModelName = None,
    *,
    unknown: UnknownMembraneOptions,
    points: Annotated[
        tuple[int, int] | None,
        Option("Points along log Ca and along a/l; default: 28 20, with the membrane unknown 10 6."),
    ] = None,
    noises: Annotated[
        int | None, Option("Measurements that each width is averaged over; default: 13.", min=0, max=10_000)
    ] = None,
) -> None:
    """Map the relative width of G_s and a that a lab would get with its own errors.

    With --membrane, the standard deviation of ln G_s with the membrane unknown, next to that with it known.

    The map has no randomness. Exit status: 0 done, 2 bad input.
    """
    from capsbayes.run import resumable

    if points is not None and not all(2 <= count <= _MOST_POINTS for count in points):
        raise InputError("map", "--points", f"two numbers from 2 to {_MOST_POINTS}", " ".join(map(str, points)))
    errors, known, stated = lab.read()
    sheet = membrane_of(stated, unknown.membrane)
    unknown.check("map", sheet, {"--database": database, "--noises": noises})
    with resumable(out):
        if sheet is None:
            short, parts, files = _map_of_law(database, known, lengths_alone(errors), points, noises)
        else:
            short, parts, files = _map_of_membrane(known, errors, unknown.expected(sheet), points)
        model_line = model_words(short["model"], short["model_sha256"])
        conclude(short, [*parts, model_line], files, out=out)


Mapped = tuple[dict[str, Any], "Parts", dict[str, Writer]]


def _map_of_law(
    database: str | None, known: cb.Experiment, errors: cb.LabErrors, points: tuple[int, int] | None, noises: int | None
) -> Mapped:
    """Compute the map of a known law: what is short of it, what is printed, and its files."""
    from capsbayes.plan.membrane import MEMBRANE_GRID
    from capsbayes.plan.widths import NOISES
    from capsbayes.report import identifiability_figure
    from capsbayes.run import tracked

    model, count = named_model(database, known.cross_section), NOISES if noises is None else noises
    widths = cb.identifiability_map(model, known, errors, grid=points or MEMBRANE_GRID, noises=count, progress=tracked)
    short = _short(widths)
    files = _map_files(widths, short) | {
        "map.png": figure_file(lambda: identifiability_figure(widths)),
        "map-radius.png": figure_file(lambda: identifiability_figure(widths, "capsule_radius")),
    }
    return short, _map_lines(short), files


def _map_of_membrane(
    known: cb.Experiment, errors: cb.LabErrors, expected: dict[str, Any], points: tuple[int, int] | None
) -> Mapped:
    """Compute the map with the membrane unknown: what is short of it, what is printed, and its files."""
    from capsbayes.plan import membrane_map
    from capsbayes.plan.membrane import MEMBRANE_GRID
    from capsbayes.report.plan import expected_words, membrane_map_figure, membrane_map_table
    from capsbayes.run import tracked

    widths = membrane_map(known, errors, **expected, grid=points or MEMBRANE_GRID, progress=tracked)
    short = _short_of_membrane(widths)
    files = _map_files(widths, short) | {"map.png": figure_file(lambda: membrane_map_figure(widths))}
    return short, [membrane_map_table(short["quantiles"]), expected_words(short["membrane"])], files


def _map_files(widths: xr.Dataset, short: dict[str, Any]) -> dict[str, Writer]:
    return {"map.nc": lambda path: write_dataset(path, widths), "map.json": json_file(short)}


def _short_of_membrane(widths: xr.Dataset) -> dict[str, Any]:
    """Return quantiles of the standard deviations over the map, and what it holds for."""
    import numpy as np

    quantiles = {}
    for name in map(str, widths.data_vars):
        if widths[name].ndim == 2:
            values = widths[name].to_numpy()
            levels = np.quantile(values[np.isfinite(values)], [0.0, 0.25, 0.5, 0.75, 1.0])
            quantiles[name] = dict(zip(("least", "lower", "median", "upper", "most"), levels.tolist(), strict=True))
    points = int(np.isfinite(widths["unknown_lengths"].to_numpy()).sum())
    made_for = _made_for(widths) | {"membrane": json.loads(widths.attrs["membrane"])}
    return {"quantiles": quantiles, "points": points, **made_for}


def _short(widths: xr.Dataset) -> dict[str, Any]:
    """Return the best point of the map, and the share of its points below some widths."""
    import numpy as np

    from capsbayes.infer.verdict import LEANING_SHARE

    width = widths["width_of_surface_shear_modulus"].to_numpy()
    known = np.isfinite(width)
    measured = known & (widths["leaning"].to_numpy() <= LEANING_SHARE)
    below = {f"{level:.0%}": float(np.mean(width[known] <= level)) for level in (0.05, 0.1, 0.2, 0.5)}
    return {
        "best": _best(widths, np.where(measured, width, np.inf)),
        "share_of_points_with_width_below": below,
        "share_of_points_that_lean_on_the_border": float(1.0 - measured.sum() / known.sum()),
        "points": int(known.sum()),
        **_made_for(widths),
        "noises": int(widths.attrs["noises"]),
    }


def _made_for(widths: xr.Dataset) -> dict[str, Any]:
    """Return the model, and the experiment and the errors for which a map holds."""
    texts = {name: widths.attrs[name] for name in ("model", "model_sha256", "cross_section", "version")}
    return texts | {name: json.loads(widths.attrs[name]) for name in ("experiment", "errors")}


def _best(widths: xr.Dataset, width: Floats) -> dict[str, float] | None:
    """Return the smallest width and its point; None where none is measured."""
    import numpy as np

    if not np.isfinite(width).any():
        return None
    row, column = np.unravel_index(np.argmin(width), width.shape)
    return {
        "capillary_number": float(widths["capillary_number"][column]),
        "size_ratio": float(widths["size_ratio"][row]),
        "width_of_surface_shear_modulus": float(width[row, column]),
        "width_of_capsule_radius": float(widths["width_of_capsule_radius"][row, column]),
    }


def _map_lines(short: dict[str, Any]) -> list[str]:
    best, below = short["best"], short["share_of_points_with_width_below"]
    first = "With these errors G_s cannot be measured anywhere on the map."
    if best is not None:
        first = (
            f"G_s is measured best at Ca = {best['capillary_number']:.3g}, a/l = {best['size_ratio']:.3g}: to ± "
            f"{best['width_of_surface_shear_modulus']:.1%}, and a to ± {best['width_of_capsule_radius']:.1%} "
            "(half of the 68 % interval over the median)."
        )
    shares = ", ".join(f"{level}: {share:.0%}" for level, share in below.items())
    return [
        first,
        f"Share of the {short['points']} points at which the width of G_s is at most {shares}.",
        f"At {short['share_of_points_that_lean_on_the_border']:.0%} of them the posterior leans on the border of the "
        "database: the width is cut there, and not measured.",
    ]


@command
def flow(
    shear_modulus: Annotated[str, Option('Expected G_s, as "50 mN/m" or "50 +/- 10 mN/m".')],
    radius: Annotated[str, Option('Expected a, as "24 um" or "24 +/- 1 um".')],
    lab: LabOptions,
    planned: PlannedBatchOptions,
    out: Annotated[Path | None, results("flow.json", "flow.csv", "flow.png")] = None,
    database: ModelName = None,
    margin: Annotated[float, Option("Share of the limiting Ca by which to stay below it.", min=0.0, max=0.99)] = 0.1,
    risk: Annotated[
        float, Option("Probability that a capsule comes nearer to the limit than that.", min=0.0, max=0.99)
    ] = 0.05,
    simulate: Annotated[
        int, Option("Capsules to simulate at the best flow rate, to try the predicted width.", min=0, max=10_000)
    ] = 0,
    seed: Seed = 1,
) -> None:
    """Choose the flow rate: the smallest expected width of G_s below the limit of existence.

    With --membrane, the flow rates at which a batch of capsules tells its membrane and its G_s best.

    Exit status: 0 done, 1 no flow rate is safe or measures G_s, 2 bad input.
    """
    from capsbayes.run import resumable

    modulus = cb.Quantity.of_text(shear_modulus, "surface_shear_modulus", where="flow", key="--shear-modulus")
    size = cb.Quantity.of_text(radius, "capsule_radius", where="flow", key="--radius")
    errors, known, stated = lab.read()
    asked = {"seed": seed, "margin": margin, "risk": risk}
    sheet = membrane_of(stated, planned.membrane)
    planned.check("flow", sheet, {"--database": database, "--simulate": simulate or None})
    with resumable(out):
        if sheet is None:
            expected = modulus, size, known, lengths_alone(errors), named_model(database, known.cross_section)
            design, result, parts, figure = _flow_of_law(expected, asked, simulate)
        else:
            design, result, parts, figure = _flow_of_membrane((modulus, size, known, errors), sheet, planned, asked)
        files: dict[str, Writer] = {
            "flow.json": json_file(result),
            "flow.csv": table_file(design.table(), index=False),
            "flow.png": figure_file(figure),
        }
        model_line = model_words(design.lab["model"], design.lab["model_sha256"], design.seed)
        conclude(result, [*parts, model_line], files, out=out, status=design.status)


Designed = tuple["FlowDesign | MembraneFlowDesign", dict[str, Any], "Parts", Callable[[], "Figure"]]


def _flow_of_law(expected: tuple[Any, ...], asked: dict[str, Any], simulate: int) -> Designed:
    """Design the flow rate for a known law."""
    from capsbayes.plan import simulated_widths
    from capsbayes.report import flow_figure
    from capsbayes.report.plan import flow_table
    from capsbayes.run import tracked

    design, tried = cb.flow_design(*expected, **asked, progress=tracked), None
    if simulate and design.best is not None:
        speed = design.best.mean_velocity
        tried = simulated_widths(*expected, mean_velocity=speed, count=simulate, seed=asked["seed"])
    result = design.as_dict() | ({} if tried is None else {"simulated": tried.as_dict()})
    return design, result, [flow_table(design), *_flow_lines(design, tried)], lambda: flow_figure(design)


def _flow_of_membrane(
    expected: tuple[Any, ...], sheet: cb.Membrane, planned: PlannedBatchOptions, asked: dict[str, Any]
) -> Designed:
    """Design the flow rates for a batch whose membrane is unknown."""
    from capsbayes.report.plan import membrane_flow_figure, membrane_flow_parts
    from capsbayes.run import tracked

    how = asked | planned.expected(sheet)
    design = cb.membrane_flow_design(
        *expected,
        **how,
        capsules=planned.capsules or _CAPSULES,
        same_capsule=planned.same_capsule,
        flows=planned.flows or _FLOWS,
        scale_error=planned.scale_error,
        velocities=planned.velocities(),
        progress=tracked,
    )
    return design, design.as_dict(), list(membrane_flow_parts(design)), lambda: membrane_flow_figure(design)


def _flow_lines(design: FlowDesign, tried: SimulatedWidths | None) -> list[str]:
    what = "the limit of existence" if design.limit.limit else "the end of the database"
    limit = (
        f"The expected capsule reaches {what}, Ca = {design.limit.highest:.3g}, at U = "
        f"{1e3 * design.limit_velocity:.3g} mm/s."
    )
    lines = [limit] if design.best is None else _best_lines(design, design.best, limit)
    if tried is not None:
        lines.append(
            f"{len(tried.relative)} simulated capsules came out at ± {tried.mean:.1%} (standard error "
            f"{tried.standard_error:.1%}), {tried.within.mean():.0%} of them within their 68 % interval."
        )
    return lines


def _best_lines(design: FlowDesign, best: FlowPoint, limit: str) -> list[str]:
    low, high = (1e3 * speed for speed in design.good or (best.mean_velocity, best.mean_velocity))
    lines = [
        f"Best: U = {1e3 * best.mean_velocity:.3g} mm/s, Q = {6e10 * best.flow_rate:.3g} µL/min, G_s to ± "
        f"{best.relative:.1%} (half of the 68 % interval over the median), a to ± {best.relative_radius:.1%}.",
        limit,
        f"At the best flow rate Ca exceeds {1.0 - design.margin:.0%} of this limit with a probability of "
        f"{best.beyond_margin:.1%}; at most {design.risk:.0%} was asked for.",
    ]
    if low < high:
        lines.insert(1, f"From {low:.3g} to {high:.3g} mm/s the width of G_s is within 5 % of the smallest.")
    return lines


app = typer.Typer(
    help="The share of each input in the intervals of G_s and a, how precisely and at which flow rate to measure them.",
    no_args_is_help=True,
)
for _name, _command in {"budget": budget, "sobol": sobol, "map": identifiability, "flow": flow}.items():
    app.command(_name)(_command)
