"""What ``capsbayes identify`` prints of a posterior."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table

    from capsbayes.infer import Posterior


def print_posterior(posterior: Posterior, out: Path | None) -> None:
    """Print medians, intervals, shares, checks, priors and model, and where it was written."""
    from rich.console import Console

    from capsbayes.infer.verdict import LEANING_SHARE

    console = Console(highlight=False)
    console.print(_quantities(posterior))
    console.print(_shares(posterior))
    if posterior.agreement is not None:
        console.print(f"emcee and quadrature: {posterior.agreement}.")
    failed = [str(gate) for gate in posterior.gates if not gate.passed]
    passed = f"{len(posterior.gates) - len(failed)} of {len(posterior.gates)} gates passed"
    console.print(f"Gates: {passed}{': ' + '; '.join(failed) if failed else ''}.")
    for border, share in posterior.leaning.items():
        if share > LEANING_SHARE:
            console.print(f"{share:.0%} of the posterior lies next to the border of the {border}.")
    prior = posterior.prior
    console.print(
        f"Priors: G_s {prior.surface_shear_modulus.shape} from {1e3 * prior.surface_shear_modulus.low:g} to "
        f"{1e3 * prior.surface_shear_modulus.high:g} mN/m, a {prior.capsule_radius.shape} from "
        f"{1e6 * prior.capsule_radius.low:g} to {1e6 * prior.capsule_radius.high:g} um"
        f"{''.join(map(_as_text, prior.coordinates.items()))}."
    )
    console.print(f"Model: {posterior.model_name}, sha256 {posterior.model_sha256[:12]}; seed {posterior.seed}.")
    if out is not None:
        console.print(f"Written to {out}: posterior.nc, summary.json, corner.png, outline.png.")
    console.print(f"Status: {posterior.status}", style="green" if posterior.status.ok else "bold red")


def _as_text(coordinate: tuple[str, Any]) -> str:
    from capsbayes.parameters import PARAMETERS

    name, distribution = coordinate
    low, high = distribution.ppf([0.025, 0.975])
    return f", {PARAMETERS[name].symbol} {distribution.shape}, 95 % from {low:.3g} to {high:.3g}"


def _quantities(posterior: Posterior) -> Table:
    from rich import box
    from rich.markup import escape
    from rich.table import Table

    from capsbayes.parameters import PARAMETERS

    table = Table(
        title=f"Posterior by {posterior.engine}: median and equal-tailed intervals",
        box=box.SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    table.title_justify = "left"
    table.add_column("", no_wrap=True)
    others = ["quadrature"] if posterior.reference else []
    for heading in ("median", "68 %", "95 %", *others, "paper"):
        table.add_column(heading, justify="right", no_wrap=True)
    paper = posterior.deterministic.as_dict() if posterior.deterministic else {}
    for name, marginal in posterior.marginals.items():
        one = PARAMETERS[name]
        digits = _digits(marginal.sd * one.scale)
        values = [
            (marginal.median,),
            (marginal.lower_68, marginal.upper_68),
            (marginal.lower_95, marginal.upper_95),
            *([(posterior.reference[name].median,)] if others else []),
            *([(paper[name],)] if name in paper else []),
        ]
        shown = ["..".join(f"{one.scale * value:.{digits}f}" for value in group) for group in values]
        table.add_row(escape(one.label), *shown)
    return table


def _digits(error: float) -> int:
    """Decimals that show two digits of an error."""
    import math

    return max(0, 1 - math.floor(math.log10(error))) if error > 0.0 else 3


def _shares(posterior: Posterior) -> Table:
    from rich import box
    from rich.table import Table

    from capsbayes.parameters import PARAMETERS

    table = Table(title="Share of the variance of log G_s owed to each input", box=box.SIMPLE_HEAD, show_header=False)
    table.title_justify = "left"
    table.add_column("")
    table.add_column("share", justify="right")
    for name, share in posterior.shares.items():
        one = PARAMETERS.get(name)
        table.add_row(f"{one.symbol}, {one.meaning}" if one else name, f"{100.0 * share:.1f} %")
    return table
