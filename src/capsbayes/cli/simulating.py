"""Commands that simulate capsules, and that build, draw and validate databases of simulated shapes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import capsbayes as cb
from capsbayes.cli.command import Option, Options, Reads, Writes, command
from capsbayes.cli.options import DatabaseName, Scheduler, Workers
from capsbayes.cli.output import conclude, table_file, tell, waiting
from capsbayes.errors import InputError
from capsbayes.files.output_file import together
from capsbayes.report.files import figure_file, json_file
from capsbayes.status import Status

if TYPE_CHECKING:
    import pandas as pd

    from capsbayes.physics.simulator import Snapshot

CapillaryNumber = Annotated[float, Option("Capillary number mu U / G_s.", "--ca")]
SizeRatio = Annotated[float, Option("Size ratio a/l: radius at rest over the half width of the channel.")]
Plot = Annotated[Path | None, Writes("Draw the shape in a .png, .pdf or .svg file.", ".png", ".pdf", ".svg")]

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
_COLUMNS = {  # heading and digits of what is printed of a snapshot
    "time": ("U t / l", ".4g"),
    "axial_extent": ("L_z / l", ".4f"),
    "axial_length": ("L_a / l", ".4f"),
    "velocity_ratio": ("v_o / U", ".4f"),
    "speed": ("speed / U", ".1e"),
}


@dataclass(frozen=True)
class SimulatorOptions(Options):
    """Membrane, channel and mesh of a simulation."""

    law: Annotated[
        str,
        Option(
            "Membrane law with its parameters, as skalak:hardening=1 (several are separated by commas): "
            "neo-hookean; skalak (hardening); hooke (poisson_ratio); strain-hardening (strain_hardening); "
            "hooke-share (hooke_share); general (area_dilation_modulus and strain_hardening); evans-skalak "
            "(area_dilation_modulus)."
        ),
    ] = "neo-hookean"
    cross_section: Annotated[str, Option("Cross-section of the channel: square, rectangular or circular.")] = "square"
    corner_radius: Annotated[float, Option("Radius of the corners of a square channel, over l.")] = 0.0
    section_aspect: Annotated[float, Option("Depth of the cross-section over the width seen, b/l.")] = 1.0
    refinement: Annotated[int, Option("Subdivisions n of an edge of the mesh: 8 is quick, 12 is fit to publish.")] = 8
    bending: Annotated[float, Option("Bending stiffness B over G_s a^2.")] = 2e-4
    pre_inflation: Annotated[float, Option("Osmotic pre-inflation alpha of the radius.")] = 0.0
    rest_aspect: Annotated[float, Option("Axis at rest along the flow over the axis across it.")] = 1.0
    bending_energy: Annotated[
        str, Option("What bending costs: the change of curvature, or the displacement from rest.")
    ] = "displacement"

    def simulator(self) -> cb.Simulator:
        """Return the simulator with these settings."""
        from capsbayes.physics.membrane import law_named

        law = law_named(self.law)  # refused before the simulator is imported, which is slow
        from capsbayes.physics.simulator import Simulator

        return Simulator(**vars(self) | {"law": law})


@command
def simulate(
    capillary_number: CapillaryNumber,
    size_ratio: SizeRatio,
    settings: SimulatorOptions,
    paraview: Annotated[Path | None, Writes("Write the membrane to a .vtu file for ParaView.", ".vtu")] = None,
    plot: Plot = None,
) -> None:
    """Simulate one capsule from its capillary number and size.

    Exit status: 0 done, 1 no steady state (the status says why), 2 bad input.
    """
    simulator = settings.simulator()
    with waiting("Following the branch of steady states ..."):
        state = simulator.run(capillary_number=capillary_number, size_ratio=size_ratio)
    conclude(state.as_dict(), _state_parts(state), good=state.status.ok)
    with together():
        if paraview is not None:
            state.save(paraview)
        if plot is not None:
            from capsbayes.report.simulation import shape_figure

            figure_file(lambda: shape_figure(state), dpi=160)(plot)


def _state_parts(state: cb.SteadyState) -> Iterator[str | pd.DataFrame]:
    """Yield what is printed of a steady state."""
    from capsbayes.report.tables import table

    settings, summary = state.settings, state.as_dict()
    unusual = [f" of the {settings['bending_energy']}"] if "bending_energy" in settings else []
    unusual += [f", {key.replace('_', ' ')} {settings[key]:g}" for key in _USUAL if settings[key] != _USUAL[key]]
    yield (
        f"Ca = {state.capillary_number:g}, a/l = {state.size_ratio:g}, {settings['law']}, {settings['cross_section']} "
        f"cross-section, refinement {settings['refinement']}, bending {settings['bending']:g}" + "".join(unusual)
    )
    yield summary["message"]
    if state.status.ok:
        known = ((symbol, summary[key], meaning) for symbol, key, meaning in _ROWS)
        rows = [(symbol, f"{value:.4f}", meaning) for symbol, value, meaning in known if value is not None]
        yield table(("", "", ""), rows, numbers=(1,))


@command
def transient(
    capillary_number: CapillaryNumber,
    size_ratio: SizeRatio,
    until: Annotated[float, Option("Time U t / l at which to end.")],
    settings: SimulatorOptions,
    every: Annotated[float, Option("Time U dt / l between two rows of the table.")] = 0.2,
    viscosity_ratio: Annotated[float, Option("Viscosity inside over that outside: 1.")] = 1.0,
    scheme: Annotated[str, Option("Time steps: semi-implicit or explicit.")] = "semi-implicit",
    table: Annotated[Path | None, Writes("Write the table, a .csv file.", ".csv")] = None,
    paraview: Annotated[
        Path | None, Writes("Write the membranes to a .pvd file for ParaView.", ".pvd", next_to=("{stem}-*.vtu",))
    ] = None,
    plot: Plot = None,
) -> None:
    """Follow one capsule from rest and print its lengths and velocity over time.

    The run ends before `until` once the capsule is steady. Exit status: 0 done, 2 bad input.
    """
    from capsbayes.physics.simulator import save_series
    from capsbayes.physics.transient import STEADY
    from capsbayes.report.tables import table as rendered
    from capsbayes.run import progress_bar

    simulator: Any = settings.simulator()
    way = simulator.transient(
        capillary_number=capillary_number,
        size_ratio=size_ratio,
        until=until,
        every=every,
        scheme=scheme,
        viscosity_ratio=viscosity_ratio,
    )
    snapshots = []
    with progress_bar(until, "l / U") as update:
        for snapshot in way:
            snapshots.append(snapshot)
            update(snapshot.time)
    rows = [
        {name: float(getattr(each.profile if "axial" in name else each, name)) for name in _COLUMNS}
        for each in snapshots
    ]
    cells = ([f"{row[name]:{digits}}" for name, (_, digits) in _COLUMNS.items()] for row in rows)
    shown = rendered([head for head, _ in _COLUMNS.values()], cells, numbers=range(len(_COLUMNS)))
    speed = snapshots[-1].speed
    moving = f"Not yet steady: the fastest node moves at {speed:.2g} U, seen from the centroid."
    conclude(rows, [shown, "Steady." if speed < STEADY else moving])
    with together():
        if table is not None:
            table_file(shown, header=list(_COLUMNS), index=False)(table)
        if paraview is not None:
            save_series(snapshots, paraview)
        if plot is not None:
            from capsbayes.report.simulation import transient_figure

            figure_file(lambda: transient_figure(_chosen(snapshots)), dpi=160)(plot)


def _chosen(snapshots: list[Snapshot]) -> list[Snapshot]:
    """Return the start, the snapshots nearest to a twelfth and a quarter of the time, and the end."""
    times = [share * snapshots[-1].time for share in (0.0, 1 / 12, 0.25, 1.0)]
    chosen = [min(snapshots, key=lambda snapshot: abs(snapshot.time - time)) for time in times]
    return list(dict.fromkeys(chosen))


@command
def build(
    out: Annotated[
        Path, Writes("NetCDF file to write; finished cases are kept in OUT.parts.", ".nc", next_to=("{name}.parts/",))
    ],
    settings: SimulatorOptions,
    cases: Annotated[Path | None, Reads("CSV file with the columns capillary_number and size_ratio.")] = None,
    grid: Annotated[str | None, Option("Instead of --cases: 'default', 418 cases.")] = None,
    effect: Annotated[
        str | None, Option("One more parameter to vary over --values, as pre_inflation, or hardening of the law.")
    ] = None,
    values: Annotated[
        str | None, Option("Values of --effect, as 0,0.01,0.05: at least three, the usual one among them.")
    ] = None,
    scheduler: Scheduler = None,
    workers: Workers = None,
    compare: Annotated[
        int | None, Option("Refinement on which five cases are run again, to keep the mesh's error.")
    ] = None,
) -> None:
    """Simulate many cases and write one database; a second run continues where the first stopped.

    Exit status: 0 done, 1 not one case converged, 2 bad input.
    """
    simulator = settings.simulator()
    chosen, varied = _chosen_cases(cases, grid), _values(effect, values)
    if compare is not None and compare <= simulator.refinement:
        raise InputError("build", "--compare", "more than --refinement", str(compare))
    if compare is not None and effect is not None:
        raise InputError("build", "--compare", "nothing with --effect", str(compare))
    begin = perf_counter()
    how: dict[str, Any] = {"scheduler": scheduler, "workers": workers, "compare": compare}
    database = cb.build_database(simulator, chosen, out=out, effect=effect, values=varied, **how)
    seconds = round(perf_counter() - begin, 1)
    summary = {"file": str(out)} | database.as_dict() | {"seconds": seconds}
    statuses = [f"{count:6d}  {Status[name]}" for name, count in summary["statuses"].items()]
    lines = [f"{out}: {len(database)} cases in {seconds} s", *statuses, f"sha256  {database.sha256}"]
    tell(summary, *lines, good=len(database.converged) > 0)


def _chosen_cases(cases: Path | None, grid: str | None) -> list[tuple[float, float]]:
    from capsbayes.physics.build import default_grid, read_cases

    if (cases is None) == (grid is None):
        raise InputError("build", "--cases, --grid", "one of the two", "neither" if cases is None else "both")
    if cases is not None:
        return read_cases(cases)
    if grid != "default":
        raise InputError("build", "--grid", "one of default", repr(grid))
    return default_grid()


def _values(effect: str | None, text: str | None) -> list[float]:
    """Return the numbers of --values, which comes with --effect."""
    if (effect is None) != (text is None):
        raise InputError("build", "--effect, --values", "both or neither", "only one")
    try:
        return [float(value) for value in (text or "").split(",") if value]
    except ValueError:
        raise InputError("build", "--values", "numbers with commas between them", repr(text)) from None


@command
def atlas(
    database: DatabaseName,
    out: Annotated[Path, Writes("Folder for the pictures.", within=("*.png",))] = Path("atlas"),
) -> None:
    """Draw what a database covers: its cases and borders, velocities, lengths and shapes."""
    from capsbayes.report.database import atlas as figures_of
    from capsbayes.report.style import write_figure
    from capsbayes.run import resumable

    whole = cb.Database.open(database)
    with resumable(out), waiting("Drawing ..."), together():
        paths = [write_figure(figure, out / f"{name}.png") for name, figure in figures_of(whole).items()]
    files = {str(path): path.stat().st_size for path in paths}
    done, listed = len(whole.converged), [{"file": name, "bytes": size} for name, size in files.items()]
    tell(
        {"sha256": whole.sha256, "cases": len(whole), "converged": done, "files": listed},
        f"{done} of {len(whole)} cases with a steady state",
        *(f"  {name}  {size / 1000:.0f} kB" for name, size in files.items()),
    )


@command
def validate(
    database: DatabaseName = "square-neo-hookean",
    out: Annotated[
        Path | None, Writes("Folder for the heat maps and the table.", within=("validation.json", "errors-*.png"))
    ] = None,
) -> None:
    """Hold out one case at a time, and identify it from its two lengths."""
    import pandas as pd

    from capsbayes.report.database import heat_maps
    from capsbayes.run import resumable
    from capsbayes.surrogate import plane

    whole = cb.Database.open(database)
    if whole.effect != "none":
        raise InputError("validate", "database", "one over Ca and a/l alone", f"one that varies {whole.effect} as well")
    sets = {"all": whole, "even": plane.even_subset(whole)}
    with resumable(out):
        with waiting("Holding out one case at a time ..."):
            pairs = {name: (plane.validate_inverse(of), plane.validate_forward_map(of)) for name, of in sets.items()}
        rows = []
        for name, pair in pairs.items():
            for study, which in product(pair, plane.CHOICES):
                summary, row = study.summary(which), {"set": name, "method": study.method, "which": which}
                figures = {figure: getattr(summary, figure) for figure in ("mean", "sd", "median")}
                of_parameters: Any = pd.DataFrame(figures, index=plane.PARAMETERS).to_dict(orient="index")
                rows.append(row | {"count": summary.cases, "failed": summary.failed} | of_parameters)
        paper = {key: dict(zip(plane.PARAMETERS, values, strict=True)) for key, values in plane.PAPER_ERRORS.items()}
        errors = {"sha256": whole.sha256, "stretch_limit": plane.STRETCH_LIMIT, "relative_errors": rows, "paper": paper}
        maps = {f"errors-{name}.png": figure_file(partial(heat_maps, *pair), 150) for name, pair in pairs.items()}
        conclude(errors, [_error_table(rows)], {"validation.json": json_file(errors)} | maps, out=out)


def _error_table(errors: list[dict[str, Any]]) -> pd.DataFrame:
    from capsbayes.report.tables import Symbols, table
    from capsbayes.surrogate.plane import CHOICES, PAPER_ERRORS, PARAMETERS

    rows = []
    for row in errors:
        lost = f", {row['failed']} lost" if row["failed"] else ""
        cases = f"{row['count']} {row['set'] if row['which'] == 'all' else CHOICES[row['which']]}{lost}"
        figures = (row[parameter] for parameter in PARAMETERS)
        rows.append([cases, row["method"], *(f"{100 * of['mean']:.2f} ± {100 * of['sd']:.2f}" for of in figures)])
    published = (f"{100 * mean:.1f} ± {100 * sd:.1f}" for mean, sd in zip(*PAPER_ERRORS.values(), strict=True))
    rows.append([CHOICES["stretched"], "as published", *published])
    head = ("cases", "method", *map(Symbols, ("Ca", "a/l", "v_o/U")))
    return table(head, rows, title="Leave-one-out: relative error, mean ± sd [%]", numbers=(2, 3, 4))
