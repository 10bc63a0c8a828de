"""``capsbayes sensitivity``: the share of each input in the interval of a capsule, and where a lab should measure."""

from __future__ import annotations

import typer

from capsbayes.cli.output import quietable
from capsbayes.cli.paths import checked
from capsbayes.cli.sensitivity.budget import budget
from capsbayes.cli.sensitivity.flow import flow
from capsbayes.cli.sensitivity.map import identifiability
from capsbayes.cli.sensitivity.sobol import sobol

app = typer.Typer(
    help="The share of each input in the intervals of G_s and a, how precisely and at which flow rate to measure them.",
    no_args_is_help=True,
)
app.command("budget")(quietable(checked(budget)))
app.command("sobol")(quietable(checked(sobol)))
app.command("map")(quietable(checked(identifiability)))
app.command("flow")(quietable(checked(flow)))
