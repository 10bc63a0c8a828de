"""Compare surrogates with simulations at Ca, a/l and sizes of an effect that their databases do not contain.

Run ``python benchmarks/off_nodes.py``. The simulations are those of ``data/pools``, at refinement 12. Differences are
in thousandths of l (of U for the velocity); the last column is their rms over the error that the surrogate states.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from capsbayes.database import Database
from capsbayes.effects import catalogue
from capsbayes.evidence.blind.pools import POOLS, pool_name
from capsbayes.surrogate import Surrogate

FOLDER = Path(__file__).parents[1] / "data" / "pools"
QUANTITIES = {"axial_extent": "L_z", "axial_length": "L_a", "velocity_ratio": "v_o/U"}


def main() -> None:
    table = Table(
        "effect", "size", "n", *(f"{name} rms (max)" for name in QUANTITIES.values()), "over stated", box=SIMPLE
    )
    base = Surrogate.open("square-neo-hookean")
    for effect, size in POOLS:
        path = FOLDER / f"{pool_name(effect, size)}.nc"
        if not path.exists() or effect not in ("none", *catalogue()):
            continue
        shapes = Database.read(path).converged
        model = base if effect == "none" else base + catalogue()[effect]
        theta = {name: shapes[name] for name in ("capillary_number", "size_ratio")}
        found = model(theta | {effect: np.full(len(theta["size_ratio"]), size)})
        away = np.stack([getattr(found, name) - shapes[name] for name in QUANTITIES], axis=1)[found.inside]
        stated = np.sqrt(np.diagonal(found.covariance[found.inside], axis1=1, axis2=2))
        rms, largest = 1e3 * np.sqrt(np.mean(away**2, axis=0)), 1e3 * np.abs(away).max(axis=0)
        over = np.sqrt(np.mean((away / stated) ** 2, axis=0))
        table.add_row(
            effect.replace("_", " "),
            f"{size:g}",
            str(len(away)),
            *(f"{mean:.2f} ({most:.1f})" for mean, most in zip(rms, largest, strict=True)),
            ", ".join(f"{ratio:.2f}" for ratio in over),
        )
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
