"""What an effect that the model omits does to G_s and a: ``python -m evidence.benchmarks.omitted_effects --write``.

The effects and their sizes are those of the exam. The plain model is fitted to the outlines of forty capsules with
each, measured without errors and weighted as with errors of 0.01 l. Takes half a minute.

``--write`` renews ``evidence/results/omitted-effects.json`` and the table in ``docs/limits.md``.
"""

from __future__ import annotations

import numpy as np
from threadpoolctl import threadpool_limits

from capsbayes import Surrogate
from capsbayes.database import Database
from capsbayes.diagnosis.blind import TRUE_EFFECTS, Lab, Noise, draw_session
from capsbayes.diagnosis.fits import fitted
from capsbayes.diagnosis.scores import whitening
from capsbayes.diagnosis.search import Comparison
from evidence.benchmarks.stored import POOL_FOLDER, Stored, with_write
from evidence.exam.sessions import CELLS, Cell, pool_name
from evidence.markdown import table

LAB, CAPSULES, SEED = Lab(noise=Noise(understated=0.0)), 40, 1
EFFECTS = {
    "pre_inflation": "pre-inflation $\\alpha$",
    "bending": "bending stiffness $B$, for $2 \\times 10^{-4}$",
    "strain_hardening": "strain hardening",
    "hooke_share": "share of Hooke's law",
    "rest_aspect": "at rest, length over width",
    "section_aspect": "cross-section, depth over width",
    "corner_radius": "radius of its corners over $\\ell$",
    "unsteadiness": "not yet steady, $\\ell/(Ut)$",
    "halo": "halo over $\\ell$",
    "exposure": "motion during the exposure over $\\ell$",
    "swelling": "channel wider by, over $\\ell$",
    "pixel_scale": "pixels too large by",
    "pixel_aspect": "pixels, height over width",
    "distortion": "distortion at $\\ell$ from the middle",
    "taper": "change of magnification over $\\ell$ along the flow",
    "velocity_scale": "velocities too large by",
}
HEAD = ("effect omitted", "size", "G_s off by", "a off by", "outline still off, ℓ/1000")


def cells() -> list[Cell]:
    """Return the cells of the exam with one effect that changes what is measured of a capsule, in the table's order."""
    return [cell for effect in EFFECTS for cell in CELLS if cell.effect == effect and cell.known and not cell.also]


def omitted(cell: Cell, model: Surrogate) -> dict[str, float]:
    """Return the medians of what ln G_s and ln a are off by, and the distance of the outlines [l]."""
    shapes = Database.read(POOL_FOLDER / f"{pool_name(*cell.shapes)}.nc")
    effect, size = TRUE_EFFECTS[cell.effect], cell.size_in(LAB)
    blind = draw_session(shapes, effect, size, lab=LAB, capsules=CAPSULES, seed=SEED)
    fits = fitted(model, blind.session, whitening(model, blind.session))
    fitting = fits.settled
    radius = np.array([capsule.capsule_radius for capsule in blind.capsules])
    return {
        "capsules": int(fitting.sum()),
        "log_modulus": float(np.median((fits.log_modulus - blind.log_modulus)[fitting])),
        "log_radius": float(np.median(np.log(fits.size * LAB.half_width / radius)[fitting])),
        "gap": Comparison(blind.session, model, fits).gap / LAB.half_width,
    }


def tables(found: dict[str, dict[str, float]]) -> dict[str, str]:
    """Return the table, a row for each effect."""
    rows = []
    for effect, words in EFFECTS.items():
        sizes = [cell for cell in cells() if cell.effect == effect]
        mine = [found[cell.name] for cell in sizes]
        off = (", ".join(f"{np.expm1(one[key]):+.1%}" for one in mine) for key in ("log_modulus", "log_radius"))
        gaps = ", ".join(f"{1e3 * one['gap']:.1f}" for one in mine)
        rows.append((words, ", ".join(f"{cell.size:g}" for cell in sizes), *off, gaps))
    return {"omitted effects": table(HEAD, rows)}


STORED = Stored("omitted-effects.json", "docs/limits.md", tables)


def main() -> None:
    given = with_write(__doc__).parse_args()
    model = Surrogate.open("square-neo-hookean")
    with threadpool_limits(1):
        found = {cell.name: omitted(cell, model) for cell in cells()}
    STORED.show(found, write=given.write)


if __name__ == "__main__":
    main()
