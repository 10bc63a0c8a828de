"""Options of the commands that simulate: one for each parameter of the simulator."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from capsbayes.physics.simulation import Simulator

__all__ = [
    "Bending",
    "CornerRadius",
    "Law",
    "PreInflation",
    "Refinement",
    "RestAspect",
    "Section",
    "SectionAspect",
    "simulator_of",
]

Law = Annotated[
    str,
    typer.Option(
        help="Membrane law: neo-hookean, skalak:hardening=1, hooke:poisson_ratio=0.5 or "
        "strain-hardening:strain_hardening=0.5."
    ),
]
Section = Annotated[str, typer.Option(help="Section of the channel: square, rectangular or circular.")]
CornerRadius = Annotated[float, typer.Option(help="Radius of a square section's corners over l.")]
SectionAspect = Annotated[float, typer.Option(help="Depth of the section over the width seen, b/l.")]
Refinement = Annotated[int, typer.Option(help="Fineness n of the mesh: 8 is quick, 12 is fit to publish.")]
Bending = Annotated[float, typer.Option(help="Bending stiffness B over G_s a^2.")]
PreInflation = Annotated[float, typer.Option(help="Osmotic pre-inflation alpha of the radius.")]
RestAspect = Annotated[float, typer.Option(help="Axis at rest along the flow over that across.")]


def simulator_of(
    law: str,
    section: str,
    corner_radius: float,
    section_aspect: float,
    refinement: int,
    bending: float,
    pre_inflation: float,
    rest_aspect: float,
) -> Simulator:
    """The simulator of these options.

    Raises
    ------
    InputError
        Naming the option that will not do.
    """
    from capsbayes.physics.membrane import law_named

    membrane = law_named(law)
    from capsbayes.physics.simulation import Simulator  # slow to import: after the check of the law

    return Simulator(
        law=membrane,
        section=section,
        refinement=refinement,
        bending=bending,
        pre_inflation=pre_inflation,
        corner_radius=corner_radius,
        section_aspect=section_aspect,
        rest_aspect=rest_aspect,
    )
