"""``capsbayes simulate``: the steady state of one capsule."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capsbayes.cli.options import AsJson, CapillaryNumber, Plot, SizeRatio, simulator_of, with_options_of
from capsbayes.cli.output import print_json
from capsbayes.cli.paths import Writes
from capsbayes.files.output_file import together

if TYPE_CHECKING:
    from capsbayes.physics.simulator import SteadyState


@with_options_of(simulator_of, "simulator")
def simulate(
    capillary_number: CapillaryNumber,
    size_ratio: SizeRatio,
    simulator: Any,
    paraview: Annotated[
        Path | None, typer.Option(help="Write the membrane to a .vtu file for ParaView."), Writes(".vtu")
    ] = None,
    plot: Plot = None,
    as_json: AsJson = False,
) -> None:
    """Simulate one capsule from its capillary number and size.

    Exit status: 0 done, 1 no steady state (the status says why), 2 bad input.
    """
    from rich.console import Console

    with Console(stderr=True).status("Following the branch of steady states ..."):
        state: SteadyState = simulator.run(capillary_number=capillary_number, size_ratio=size_ratio)
    if as_json:
        print_json(state.as_dict())
    else:
        _print(state)
    if not state.status.ok:
        raise typer.Exit(1)
    with together():
        if paraview is not None:
            state.save(paraview)
        if plot is not None:
            from capsbayes.report.simulation import shape_figure
            from capsbayes.report.style import write_figure

            write_figure(shape_figure(state), plot)


_ROWS = (
    ("L_z / l", "axial_extent", "extension along the flow, plane x = 0"),
    ("L_a / l", "axial_length", "length on the axis"),
    ("L_p / l", "parachute_depth", "depth of the concave rear"),
    ("Lambda", "stretch_ratio", "perimeter over that at rest"),
    ("v_o / U", "velocity_ratio", "velocity of the capsule"),
    ("p_in l / (mu U)", "inner_pressure", "pressure inside"),
    ("dP+ l / (mu U)", "extra_pressure_drop", "pressure drop that the capsule adds"),
    ("min tau / G_s", "minimum_tension", "smallest principal tension"),
    ("max tau / G_s", "maximum_tension", "largest principal tension"),
    ("sigma l / U", "wrinkling_rate", "growth of wrinkles about the axis; the shape is the smooth one"),
)
_USUAL = {"pre_inflation": 0.0, "corner_radius": 0.0, "section_aspect": 1.0, "rest_aspect": 1.0}


def _print(state: SteadyState) -> None:
    from capsbayes.report.tables import print_parts, table

    settings, summary = state.settings, state.as_dict()
    unusual = [f" of the {settings['bending_energy']}"] if "bending_energy" in settings else []
    unusual += [f", {key.replace('_', ' ')} {settings[key]:g}" for key in _USUAL if settings[key] != _USUAL[key]]
    words = (
        f"Ca = {state.capillary_number:g}, a/l = {state.size_ratio:g}, {settings['law']}, {settings['cross_section']} "
        f"cross-section, refinement {settings['refinement']}, bending {settings['bending']:g}" + "".join(unusual)
    )
    print_parts(words, summary["message"])
    if state.status.ok:
        known = [(symbol, summary[key], meaning) for symbol, key, meaning in _ROWS if summary[key] is not None]
        rows = [(symbol, f"{value:.4f}", meaning) for symbol, value, meaning in known]
        print_parts(table(("", "", ""), rows, numbers=(1,)))
