"""``capsbayes sensitivity flow``: at which flow rate to measure capsules of an expected G_s and a."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capsbayes.cli.options import (
    AsJson,
    ModelName,
    Seed,
    lab_of,
    lengths_alone,
    membrane_of,
    named_model,
    with_options_of,
)
from capsbayes.cli.output import conclude, model_words, table_file
from capsbayes.cli.paths import Writes
from capsbayes.cli.sensitivity.membrane_flow import planned_batch_of, print_membrane_flow
from capsbayes.errors import InputError
from capsbayes.report.files import Writer, figure_file, json_file

if TYPE_CHECKING:
    from capsbayes.plan import FlowDesign, FlowPoint, SimulatedWidths


@with_options_of(planned_batch_of, "planned")
@with_options_of(lab_of, "lab")
def flow(
    shear_modulus: Annotated[str, typer.Option(help='Expected G_s, as "50 mN/m" or "50 +/- 10 mN/m".')],
    radius: Annotated[str, typer.Option(help='Expected a, as "24 um" or "24 +/- 1 um".')],
    lab: Any,
    planned: Any,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for flow.json, flow.csv, flow.png."),
        Writes(within=("flow.json", "flow.csv", "flow.png")),
    ] = None,
    database: ModelName = None,
    margin: Annotated[
        float, typer.Option(min=0.0, max=0.99, help="Share of the limiting Ca by which to stay below it.")
    ] = 0.1,
    risk: Annotated[
        float, typer.Option(min=0.0, max=0.99, help="Probability that a capsule comes nearer to the limit than that.")
    ] = 0.05,
    simulate: Annotated[
        int,
        typer.Option(min=0, max=10_000, help="Capsules to simulate at the best flow rate, to try the predicted width."),
    ] = 0,
    seed: Seed = 1,
    as_json: AsJson = False,
) -> None:
    """Choose the flow rate: the smallest expected width of G_s below the limit of existence.

    With --membrane, the flow rates at which a batch of capsules tells its membrane and its G_s best.

    Exit status: 0 done, 1 no flow rate is safe or measures G_s, 2 bad input.
    """
    from capsbayes.quantity import Quantity
    from capsbayes.run import resumable

    modulus = Quantity.of_text(shear_modulus, "surface_shear_modulus", where="flow", key="--shear-modulus")
    size = Quantity.of_text(radius, "capsule_radius", where="flow", key="--radius")
    errors, known, stated = lab
    asked = {"seed": seed, "margin": margin, "risk": risk}
    sheet = membrane_of(stated, planned.membrane)
    with resumable(out):
        if sheet is not None:
            for option, given in {"--database": database, "--simulate": simulate or None}.items():
                if given is not None:
                    raise InputError("flow", option, "no such option with the membrane unknown", str(given))
            print_membrane_flow((modulus, size, known, errors), sheet, planned, asked, out, as_json)
            return
        planned.refuse()
        expected = (modulus, size, known, lengths_alone(errors), named_model(database, known.cross_section))
        _print_flow(expected, asked, simulate, out, as_json)


def _print_flow(
    expected: tuple[Any, ...], asked: dict[str, Any], simulate: int, out: Path | None, as_json: bool
) -> None:
    """Design the flow rate for a known law, print and write it."""
    from capsbayes.plan import flow_design, simulated_widths
    from capsbayes.report import flow_figure
    from capsbayes.report.plan import flow_table
    from capsbayes.run import tracked

    design = flow_design(*expected, **asked, progress=tracked)
    tried = None
    if simulate and design.best is not None:
        speed = design.best.mean_velocity
        tried = simulated_widths(*expected, mean_velocity=speed, count=simulate, seed=asked["seed"])
    result = design.as_dict() | ({} if tried is None else {"simulated": tried.as_dict()})
    files: dict[str, Writer] = {
        "flow.json": json_file(result),
        "flow.csv": table_file(design.table(), index=False),
        "flow.png": figure_file(lambda: flow_figure(design)),
    }
    model_line = model_words(design.lab["model"], design.lab["model_sha256"], design.seed)
    conclude(
        result,
        lambda: [flow_table(design), *_lines(design, tried), model_line],
        files,
        out=out,
        as_json=as_json,
        status=design.status,
    )


def _lines(design: FlowDesign, tried: SimulatedWidths | None) -> list[str]:
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
