"""Sixty measured capsules in a table: identify each, and estimate their population.

``python examples/batch/batch.py`` prints the median shear modulus of the batch with the errors removed. Shapes and
errors are drawn from simulations that are not in any database; ``truth.json`` gives the truth.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import capsbayes as cb

HERE = Path(__file__).parent


def main() -> None:
    model = cb.Surrogate.open("square-neo-hookean")
    experiment = cb.Experiment.read(HERE / "experiment.toml")
    with tempfile.TemporaryDirectory() as folder:
        population = cb.identify_folder(
            HERE / "capsules.csv", model, experiment, out=Path(folder) / "run.nc", seed=1, check=0.0
        )
    for status, count in population.counts.items():
        print(f"{count:3d}  {status}")
    batch = cb.hierarchy(population, seed=1).marginals
    for name, scale, unit in (("surface_shear_modulus", 1e3, "mN/m"), ("capsule_radius", 1e6, "um")):
        one = batch[name]
        print(f"{name}: {scale * one.median:.3g} {unit}, 95 % [{scale * one.lower_95:.3g}, {scale * one.upper_95:.3g}]")
    print(f"capsules differ in G_s by {batch['modulus_spread'].median:.1%}")
    print(f"G_s [mN/m] = {1e3 * batch['surface_shear_modulus'].median:.3g}")


if __name__ == "__main__":
    main()
