"""``capsbayes sensitivity``: the share of each input in the interval of a capsule, and where a lab should measure."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import capsbayes as cb
from capsbayes.cli import options
from capsbayes.cli.command import Option, Options, command, results
from capsbayes.cli.output import conclude, model_words, table_file, waiting
from capsbayes.errors import InputError
from capsbayes.files.output_file import write_dataset
from capsbayes.report.files import Writer, figure_file, json_file

if TYPE_CHECKING:
    import xarray as xr

    from capsbayes.plan import FlowDesign, SimulatedWidths, SobolStudy

_CAPSULES, _FLOWS = 40, 4  # of a batch that is to tell its membrane
_MOST_POINTS = 200  # of a map along an axis


@dataclass(frozen=True)
class UnknownMembraneOptions(Options):
    """What is known and expected of a membrane that is not known."""

    membrane: options.MembraneKnown = None
    guess: Annotated[
        list[str] | None,
        Option(
            "What is expected of the membrane where it is not known, in the words of --membrane, as "
            "pre_inflation=0.03 or neo-Hookean; default: the middles of the priors; may be given several times."
        ),
    ] = None
    prior: options.Priors = None

    def expected(self, sheet: cb.Membrane) -> dict[str, Any]:
        """Return what is known and what is expected, by the names of the library."""
        guess = options.membrane_of(None, self.guess, "--guess")
        return {"membrane": sheet, "guess": guess, "prior": options.prior_of(self.prior)}

    def known(self, stated: cb.Membrane | None, command: str, of_law: Mapping[str, object]) -> cb.Membrane | None:
        """Return what is known of the membrane, None of a known law; refuse the options that go with the other."""
        sheet = options.membrane_of(stated, self.membrane)
        for option, value in (self.given() if sheet is None else of_law).items():
            if sheet is None:
                raise InputError(command, option, "--membrane with it", f"{value} without")
            if value is not None:
                raise InputError(command, option, "no such option with the membrane unknown", str(value))
        return sheet


@dataclass(frozen=True)
class PlannedBatchOptions(UnknownMembraneOptions):
    """A batch that is to tell its membrane."""

    capsules: Annotated[int | None, Option(f"Capsules of the batch; default: {_CAPSULES}.", min=1, max=100_000)] = None
    same_capsule: Annotated[
        bool, Option("One capsule is filmed at all flow rates, in place of a batch.", "--same-capsule")
    ] = False
    flows: Annotated[int | None, Option(f"Most flow rates to film a batch at; default: {_FLOWS}.", min=1, max=5)] = None
    scale_error: options.ScaleError = 0.0
    mean_velocity: Annotated[
        list[str] | None,
        Option('Mean velocity of a flow to film a batch at, as "2 mm/s"; default: the best are sought.'),
    ] = None

    def expected(self, sheet: cb.Membrane) -> dict[str, Any]:
        """Return what is known, what is expected and what is planned, by the names of the library."""
        key, velocities = "--mean-velocity", []
        for text in self.mean_velocity or []:
            speed = cb.Quantity.read(text, where=key, key="", units=("m/s",), example="2 mm/s")
            if not speed.known:
                raise InputError(key, "", 'a number without an error, as "2 mm/s"', str(speed))
            velocities.append(speed.value)
        batch = {"capsules": self.capsules or _CAPSULES, "flows": self.flows or _FLOWS, "velocities": velocities}
        return super().expected(sheet) | batch | {"same_capsule": self.same_capsule, "scale_error": self.scale_error}


@command
def budget(
    capsule: options.CapsuleFile,
    out: Annotated[Path | None, results("budget.json", "budget.csv", "budget.png")] = None,
    experiment: options.ExperimentFile = None,
    database: options.ModelName = None,
    membrane: options.MembraneKnown = None,
    seed: options.Seed = 1,
) -> None:
    """Compute the share of the variance of G_s and a due to each input, and how both change with it.

    With --membrane, what is not known of the membrane has shares too.

    Exit status: 0 done, 1 the posterior cannot be used (the status says why), 2 bad input.
    """
    from capsbayes.report.plan import budget_figure, budget_table
    from capsbayes.run import resumable

    measurement = cb.Measurement.read(capsule)
    sheet = options.membrane_of(cb.Membrane.read(capsule), membrane)
    known = options.named_experiment(measurement, experiment)
    model, prior = options.capsule_model(database, sheet, known, measurement), cb.Prior.read(capsule)
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
        model_line = model_words(**result["model"], seed=seed)
        conclude(result, [budget_table(shares), *shares.notes, model_line], files, out=out, status=shares.status)


@command
def sobol(
    capsule: options.CapsuleFile,
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
    experiment: options.ExperimentFile = None,
    database: options.ModelName = None,
    seed: options.Seed = 1,
) -> None:
    """Compute the Sobol indices of the deterministic answer (G_s, a, Ca, a/l) over ranges of the inputs.

    Exit status: 0 done, 1 the ranges leave the database, 2 bad input.
    """
    from capsbayes.plan import varied_range
    from capsbayes.report.plan import sobol_figure, sobol_table
    from capsbayes.run import resumable

    stated = {}
    for text in ranges or []:
        name, equals, span = text.partition("=")
        if not equals:
            raise InputError("--range", "", "NAME=RANGE", repr(text))
        stated[name.strip()] = varied_range(span, name.strip(), where="--range")
    measurement = cb.Measurement.read(capsule)
    known = options.named_experiment(measurement, experiment)
    model = options.named_model(database, known.cross_section)
    with resumable(out):
        with waiting("Answering the samples ..."):
            study = cb.sobol_indices(measurement, model, known, seed=seed, ranges=stated, samples=samples)
        result = study.as_dict()
        figure = figure_file(lambda: sobol_figure(study))
        files: dict[str, Writer] = {"sobol.json": json_file(result), "sobol.png": figure}
        parts = [*_sobol_lines(study), model_words(**result["model"], seed=seed)]
        conclude(result, [sobol_table(study), *parts], files, out=out, status=study.status)


def _sobol_lines(study: SobolStudy) -> Iterator[str]:
    yield f"{study.samples} samples in {study.groups} groups."
    if study.outside:
        share = study.outside / study.samples
        yield (
            f"{study.outside} of them ({share:.1%}) have a shape that no capsule of the database has; they were given "
            f"the answer of the nearest shape. Without their groups the indices of G_s and a change by at most "
            f"{study.change:.3f}."
        )
    yield from study.notes


@command
def identifiability(
    lab: options.LabOptions,
    out: Annotated[Path | None, results("map.nc", "map.json", "map.png", "map-radius.png")] = None,
    database: options.ModelName = None,
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
    from capsbayes.plan import membrane_map
    from capsbayes.plan.membrane import MEMBRANE_GRID
    from capsbayes.plan.widths import NOISES
    from capsbayes.report import plan as shown
    from capsbayes.run import resumable, tracked

    if points is not None and not all(2 <= count <= _MOST_POINTS for count in points):
        raise InputError("map", "--points", f"two numbers from 2 to {_MOST_POINTS}", " ".join(map(str, points)))
    errors, known, stated = lab.read()
    sheet = unknown.known(stated, "map", {"--database": database, "--noises": noises})
    how: dict[str, Any] = {"grid": points or MEMBRANE_GRID, "progress": tracked}
    with resumable(out):
        if sheet is None:
            errors, model = options.lengths_alone(errors), options.named_model(database, known.cross_section)
            how["noises"] = NOISES if noises is None else noises
            widths = cb.identifiability_map(model, known, errors, **how)
            short = _short(widths)
            parts: list[Any] = [*_map_lines(short)]
            figures = {
                "map.png": figure_file(lambda: shown.identifiability_figure(widths)),
                "map-radius.png": figure_file(lambda: shown.identifiability_figure(widths, "capsule_radius")),
            }
        else:
            widths = membrane_map(known, errors, **unknown.expected(sheet), **how)
            short = _short_of_membrane(widths)
            parts = [shown.membrane_map_table(short["quantiles"]), shown.expected_words(short["membrane"])]
            figures = {"map.png": figure_file(lambda: shown.membrane_map_figure(widths))}
        files: dict[str, Writer] = {"map.nc": lambda path: write_dataset(path, widths), "map.json": json_file(short)}
        parts.append(model_words(short["model"], short["model_sha256"]))
        conclude(short, parts, files | figures, out=out)


def _short_of_membrane(widths: xr.Dataset) -> dict[str, Any]:
    """Return quantiles of the standard deviations over the map, and what it holds for."""
    levels = {"least": 0.0, "lower": 0.25, "median": 0.5, "upper": 0.75, "most": 1.0}
    quantiles = {
        str(name): dict(zip(levels, sds.quantile([*levels.values()]).values.tolist(), strict=True))
        for name, sds in widths.data_vars.items()
        if sds.ndim == 2
    }
    points = int(widths["unknown_lengths"].notnull().sum())
    made_for = _made_for(widths) | {"membrane": json.loads(widths.attrs["membrane"])}
    return {"quantiles": quantiles, "points": points, **made_for}


def _short(widths: xr.Dataset) -> dict[str, Any]:
    """Return the best point of the map, and the share of its points below some widths."""
    from capsbayes.infer.verdict import LEANING_SHARE

    names = ["width_of_surface_shear_modulus", "width_of_capsule_radius"]
    points = widths[[*names, "leaning"]].to_dataframe().dropna(subset=names[:1]).reset_index()
    measured = points[points["leaning"] <= LEANING_SHARE]
    best = measured.nsmallest(1, names[0])[["capillary_number", "size_ratio", *names]].to_dict(orient="records")
    below = {f"{level:.0%}": float((points[names[0]] <= level).mean()) for level in (0.05, 0.1, 0.2, 0.5)}
    return {
        "best": best[0] if best else None,
        "share_of_points_with_width_below": below,
        "share_of_points_that_lean_on_the_border": float(1.0 - (points["leaning"] <= LEANING_SHARE).mean()),
        "points": len(points),
        **_made_for(widths),
        "noises": int(widths.attrs["noises"]),
    }


def _made_for(widths: xr.Dataset) -> dict[str, Any]:
    """Return the model, and the experiment and the errors for which a map holds."""
    texts = {name: widths.attrs[name] for name in ("model", "model_sha256", "cross_section", "version")}
    return texts | {name: json.loads(widths.attrs[name]) for name in ("experiment", "errors")}


def _map_lines(short: dict[str, Any]) -> Iterator[str]:
    best, below = short["best"], short["share_of_points_with_width_below"]
    if best is None:
        yield "With these errors G_s cannot be measured anywhere on the map."
    else:
        yield (
            f"G_s is measured best at Ca = {best['capillary_number']:.3g}, a/l = {best['size_ratio']:.3g}: to ± "
            f"{best['width_of_surface_shear_modulus']:.1%}, and a to ± {best['width_of_capsule_radius']:.1%} "
            "(half of the 68 % interval over the median)."
        )
    shares = ", ".join(f"{level}: {share:.0%}" for level, share in below.items())
    yield f"Share of the {short['points']} points at which the width of G_s is at most {shares}."
    yield (
        f"At {short['share_of_points_that_lean_on_the_border']:.0%} of them the posterior leans on the border of the "
        "database: the width is cut there, and not measured."
    )


@command
def flow(
    shear_modulus: Annotated[str, Option('Expected G_s, as "50 mN/m" or "50 +/- 10 mN/m".')],
    radius: Annotated[str, Option('Expected a, as "24 um" or "24 +/- 1 um".')],
    lab: options.LabOptions,
    planned: PlannedBatchOptions,
    out: Annotated[Path | None, results("flow.json", "flow.csv", "flow.png")] = None,
    database: options.ModelName = None,
    margin: Annotated[float, Option("Share of the limiting Ca by which to stay below it.", min=0.0, max=0.99)] = 0.1,
    risk: Annotated[
        float, Option("Probability that a capsule comes nearer to the limit than that.", min=0.0, max=0.99)
    ] = 0.05,
    simulate: Annotated[
        int, Option("Capsules to simulate at the best flow rate, to try the predicted width.", min=0, max=10_000)
    ] = 0,
    seed: options.Seed = 1,
) -> None:
    """Choose the flow rate: the smallest expected width of G_s below the limit of existence.

    With --membrane, the flow rates at which a batch of capsules tells its membrane and its G_s best.

    Exit status: 0 done, 1 no flow rate is safe or measures G_s, 2 bad input.
    """
    from capsbayes.plan import simulated_widths
    from capsbayes.report import plan as shown
    from capsbayes.run import resumable, tracked

    modulus = cb.Quantity.of_text(shear_modulus, "surface_shear_modulus", where="flow", key="--shear-modulus")
    size = cb.Quantity.of_text(radius, "capsule_radius", where="flow", key="--radius")
    errors, known, stated = lab.read()
    sheet = planned.known(stated, "flow", {"--database": database, "--simulate": simulate or None})
    asked: dict[str, Any] = {"seed": seed, "margin": margin, "risk": risk, "progress": tracked}
    with resumable(out):
        if sheet is None:
            errors, model = options.lengths_alone(errors), options.named_model(database, known.cross_section)
            expected = modulus, size, known, errors, model
            design: Any = cb.flow_design(*expected, **asked)
            figure: Any = shown.flow_figure
            result, tried = design.as_dict(), None
            if simulate and design.best is not None:
                speed = design.best.mean_velocity
                tried = simulated_widths(*expected, mean_velocity=speed, count=simulate, seed=seed)
                result["simulated"] = tried.as_dict()
            parts: list[Any] = [shown.flow_table(design), *_flow_lines(design, tried)]
        else:
            design = cb.membrane_flow_design(modulus, size, known, errors, **asked, **planned.expected(sheet))
            result, figure = design.as_dict(), shown.membrane_flow_figure
            parts = [*shown.membrane_flow_parts(design)]
        files: dict[str, Writer] = {
            "flow.json": json_file(result),
            "flow.csv": table_file(design.table(), index=False),
            "flow.png": figure_file(lambda: figure(design)),
        }
        parts.append(model_words(design.lab["model"], design.lab["model_sha256"], seed))
        conclude(result, parts, files, out=out, status=design.status)


def _flow_lines(design: FlowDesign, tried: SimulatedWidths | None) -> Iterator[str]:
    best = design.best
    if best is not None:
        yield (
            f"Best: U = {1e3 * best.mean_velocity:.3g} mm/s, Q = {6e10 * best.flow_rate:.3g} µL/min, G_s to ± "
            f"{best.relative:.1%} (half of the 68 % interval over the median), a to ± {best.relative_radius:.1%}."
        )
        low, high = (1e3 * speed for speed in design.good or (best.mean_velocity, best.mean_velocity))
        if low < high:
            yield f"From {low:.3g} to {high:.3g} mm/s the width of G_s is within 5 % of the smallest."
    what = "the limit of existence" if design.limit.limit else "the end of the database"
    yield (
        f"The expected capsule reaches {what}, Ca = {design.limit.highest:.3g}, at U = "
        f"{1e3 * design.limit_velocity:.3g} mm/s."
    )
    if best is not None:
        yield (
            f"At the best flow rate Ca exceeds {1.0 - design.margin:.0%} of this limit with a probability of "
            f"{best.beyond_margin:.1%}; at most {design.risk:.0%} was asked for."
        )
    if tried is not None:
        yield (
            f"{len(tried.relative)} simulated capsules came out at ± {tried.mean:.1%} (standard error "
            f"{tried.standard_error:.1%}), {tried.within.mean():.0%} of them within their 68 % interval."
        )


app = typer.Typer(
    help="The share of each input in the intervals of G_s and a, how precisely and at which flow rate to measure them.",
    no_args_is_help=True,
)
for _name, _command in {"budget": budget, "sobol": sobol, "map": identifiability, "flow": flow}.items():
    app.command(_name)(_command)
