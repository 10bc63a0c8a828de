"""``capsbayes sensitivity flow --membrane``: at which flow rates to film a batch whose membrane is unknown."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from capsbayes.cli.options import Guess, MembraneKnown, Priors, ScaleError, membrane_of, prior_of
from capsbayes.cli.output import conclude, model_words, table_file
from capsbayes.errors import InputError
from capsbayes.report.files import Writer, figure_file, json_file

if TYPE_CHECKING:
    from capsbayes.infer import Membrane

_CAPSULES, _FLOWS = 40, 4


@dataclass(frozen=True)
class PlannedBatchOptions:
    """Options of a batch that is to tell its membrane."""

    membrane: list[str] | None
    given: dict[str, Any]

    def refuse(self) -> None:
        """Refuse them where the law is known."""
        for option, value in self.given.items():
            if value not in (None, False, 0.0, []):
                raise InputError("flow", option, "--membrane with it", f"{value} without")


def planned_batch_of(
    membrane: MembraneKnown = None,
    guess: Guess = None,
    prior: Priors = None,
    capsules: Annotated[
        int | None, typer.Option(min=1, max=100_000, help=f"Capsules of the batch; default: {_CAPSULES}.")
    ] = None,
    same_capsule: Annotated[
        bool, typer.Option("--same-capsule", help="One capsule is filmed at all flow rates, in place of a batch.")
    ] = False,
    flows: Annotated[
        int | None, typer.Option(min=1, max=5, help=f"Most flow rates to film a batch at; default: {_FLOWS}.")
    ] = None,
    scale_error: ScaleError = 0.0,
    mean_velocity: Annotated[
        list[str] | None,
        typer.Option(help='Mean velocity of a flow to film a batch at, as "2 mm/s"; default: the best are sought.'),
    ] = None,
) -> PlannedBatchOptions:
    """Return the options of a batch that is to tell its membrane."""
    given = {
        "--guess": guess,
        "--prior": prior,
        "--capsules": capsules,
        "--same-capsule": same_capsule,
        "--flows": flows,
        "--scale-error": scale_error,
        "--mean-velocity": mean_velocity,
    }
    return PlannedBatchOptions(membrane, given)


def print_membrane_flow(
    expected: tuple[Any, ...],
    sheet: Membrane,
    planned: PlannedBatchOptions,
    asked: dict[str, Any],
    out: Path | None,
    as_json: bool,
) -> None:
    """Design the flow rates for expected G_s, a, experiment and errors, print and write them."""
    from capsbayes.plan import membrane_flow_design
    from capsbayes.quantity import Quantity
    from capsbayes.report.plan import membrane_flow_figure, membrane_flow_parts
    from capsbayes.run import tracked

    given, key = planned.given, "--mean-velocity"
    speeds = [Quantity.read(text, where=key, key="", units=("m/s",), example="2 mm/s") for text in given[key] or []]
    for speed in speeds:
        if not speed.known:
            raise InputError(key, "", 'a number without an error, as "2 mm/s"', str(speed))
    design = membrane_flow_design(
        *expected,
        **asked,
        membrane=sheet,
        guess=membrane_of(None, given["--guess"], "--guess"),
        prior=prior_of(given["--prior"]),
        capsules=given["--capsules"] or _CAPSULES,
        same_capsule=given["--same-capsule"],
        flows=given["--flows"] or _FLOWS,
        scale_error=given["--scale-error"],
        velocities=[speed.value for speed in speeds],
        progress=tracked,
    )
    files: dict[str, Writer] = {
        "flow.json": json_file(design.as_dict()),
        "flow.csv": table_file(design.table(), index=False),
        "flow.png": figure_file(lambda: membrane_flow_figure(design)),
    }
    model_line = model_words(design.lab["model"], design.lab["model_sha256"], design.seed)
    conclude(
        design.as_dict(),
        lambda: [*membrane_flow_parts(design), model_line],
        files,
        out=out,
        as_json=as_json,
        status=design.status,
    )
