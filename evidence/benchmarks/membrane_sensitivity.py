"""What a batch is expected to tell of its membrane, and what it tells.

Run ``python -m evidence.benchmarks.membrane_sensitivity FOLDER``. The batches are those of ``membrane_batches``,
measured several times with other noise (``--noises``). Each finished one is kept in FOLDER, so that an interrupted run
resumes. ``--write`` renews ``evidence/results/membrane-sensitivity.json`` and the tables in
``evidence/results/membrane.md``, also that of the map, which is ``evidence/results/membrane-map.json``, a ``map.json``
of ``capsbayes sensitivity map --membrane unknown``.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from capsbayes import LabErrors, Membrane, Quantity, membrane_flow_design
from capsbayes.arrays import Floats
from capsbayes.membrane_database import FREE_PARAMETERS
from capsbayes.plan.widths import LOGARITHMIC
from evidence.benchmarks import membrane_batches, membrane_coverage, membrane_pools
from evidence.benchmarks.membrane_batches import PUMP, Session
from evidence.benchmarks.membrane_coverage import HALF_WIDTH, LENGTH_ERROR, NOISE, VELOCITY, VISCOSITY
from evidence.benchmarks.stored import Stored, complete, with_write
from evidence.markdown import table

QUANTITIES = {
    "surface_shear_modulus": "ln mean G_s",
    "pre_inflation": "alpha",
    "area_dilation_modulus": "ln K",
    "strain_hardening": "h",
    "bending": "ln B",
}
USABLE = "DONE", "LEANS_ON_BORDER"


def found(pool: dict[str, Floats], number: int, kind: str, noise: int) -> dict[str, Any]:
    """Return the standard deviations that the answer to one batch states, and its status."""
    session = Session(pool, number, kind, noise)
    answer = session.found("unknown")
    logarithmic = "surface_shear_modulus", *LOGARITHMIC
    draws = {name: answer.draws[name] for name in QUANTITIES}
    sds = {name: float(np.std(np.log(values) if name in logarithmic else values)) for name, values in draws.items()}
    return {"status": answer.status.name, **sds}


def expected(pool: dict[str, Floats], number: int, kind: str) -> dict[str, Any]:
    """Return the standard deviations that are expected of a batch of which membrane and population are known."""
    rows = np.flatnonzero(pool["batch"] == number)
    first = {key: pool[key][rows[0]] for key in membrane_pools.OF_SOME if key in pool}
    values, speeds = pool["values"][rows[0]], VELOCITY[0] * pool["flow_factor"][rows]
    modulus = float(VISCOSITY[0] * speeds[0] / values[0] / first["relative_modulus"])
    radius = float(HALF_WIDTH[0] * values[1] / first["relative_radius"])
    design = membrane_flow_design(
        Quantity(modulus, modulus * float(first["modulus_spread"]), "N/m"),
        Quantity(radius, radius * float(first["radius_spread"]), "m"),
        membrane_coverage.experiment(),
        _errors(kind),
        seed=1,
        guess=Membrane(**dict(zip(FREE_PARAMETERS[2:], values[2:].tolist(), strict=True))),
        capsules=len(rows),
        velocities=sorted(set(speeds.tolist())),
    )
    return {name: design.sets[0].sds[name] for name in QUANTITIES}


def _errors(kind: str) -> LabErrors:
    outline = NOISE if kind == "outline" else None
    return LabErrors(LENGTH_ERROR, VELOCITY[1], LENGTH_ERROR, outline=outline, flow_rate=PUMP)


def of_same_capsule(kind: str) -> dict[str, Any]:
    """Return what is expected of one capsule of a membrane in the middle of the priors, at one to four flow rates."""
    design = membrane_flow_design(
        "50 mN/m",
        Quantity(0.96 * HALF_WIDTH[0], 0.0, "m"),
        membrane_coverage.experiment(),
        _errors(kind),
        seed=1,
        same_capsule=True,
        flows=4,
    )
    return {
        str(len(planned.mean_velocities)): {
            "known": planned.sd_if_known,
            **{name: planned.sds[name] for name in QUANTITIES},
        }
        for planned in design.sets
    }


def run(folder: Path, noises: int) -> None:
    """Compute what the folder lacks."""
    pool, store = membrane_pools.stored("batches"), membrane_batches.store_of(folder)
    complete(store, ((f"same-capsule-{kind}", partial(of_same_capsule, kind)) for kind in membrane_coverage.KINDS))
    for noise in range(noises):
        for number in np.unique(pool["batch"]).astype(int).tolist():
            for kind in membrane_coverage.KINDS:
                tasks = {f"expected-{kind}-{number:02d}": partial(expected, pool, number, kind)}
                tasks[f"found-{kind}-{number:02d}-{noise}"] = partial(found, pool, number, kind, noise)
                complete(store, tasks.items())


def compared(folder: Path) -> dict[str, dict[str, Any]]:
    """Return of each kind how many answers there are, and of each quantity what is expected and found, rms.

    And how far the answers to single batches lie from what was expected of each: the smallest and the largest ratio.
    """
    store, kinds = membrane_batches.store_of(folder), {}
    for kind in membrane_coverage.KINDS:
        pairs, refused = [], 0
        for name in sorted(store.names(f"found-{kind}-*")):
            answer, wanted = store.load(name), store.load(name.replace("found", "expected", 1)[: -len("-0")])
            usable = answer is not None and wanted is not None and answer["status"] in USABLE
            refused += not usable
            if usable:
                pairs.append([[one[key] for key in QUANTITIES] for one in (wanted, answer)])
        if pairs:
            both = np.array(pairs)
            ratios = both[:, 1] / both[:, 0]
            rms = np.sqrt(np.mean(both**2, axis=0))
            columns = zip(rms[0], rms[1], rms[1] / rms[0], ratios.min(axis=0), ratios.max(axis=0), strict=True)
            rounded = [[float(f"{value:.3g}") for value in column] for column in columns]
            kinds[kind] = {
                "answers": len(pairs),
                "not to be used": refused,
                **dict(zip(QUANTITIES, rounded, strict=True)),
            }
    return kinds


def _expected_rows(kinds: dict[str, dict[str, Any]]) -> Iterator[list[str]]:
    """Yield what is expected and found."""
    for kind, row in kinds.items():
        first = [kind, str(row["answers"]), str(row["not to be used"])]
        for key, name in QUANTITIES.items():
            wanted, answered, whole, low, high = row[key]
            yield [*first, name, f"{wanted:.2g}", f"{answered:.2g}", f"{whole:.2f} ({low:.2f} to {high:.2f})"]
            first = ["", "", ""]


def _same_capsule_rows(kinds: dict[str, Any]) -> Iterator[list[str]]:
    """Yield what one capsule tells at its best flow rates."""
    for kind, sets in kinds.items():
        for number, sds in sets.items():
            shown = [sds["surface_shear_modulus"], sds["known"], *(sds[key] for key in list(QUANTITIES)[1:])]
            yield [kind, number, *(f"{value:.2g}" for value in shown)]


def _map_rows(quantiles: dict[str, Any]) -> Iterator[list[str]]:
    """Yield quantiles over the map of one capsule."""
    for name, values in quantiles.items():
        known, kind = name.split("_")
        yield [kind, known, *(f"{values[level]:.2g}" for level in ("least", "lower", "median", "upper", "most"))]


EXPECTED = ("measured", "answers", "not to be used", "standard deviation of")
EXPECTED += ("expected", "found", "found over expected")
OF_SAME = ("measured", "flow rates", "ln G_s", "were the membrane known", *list(QUANTITIES.values())[1:])
OF_MAP = ("measured", "membrane", "least", "quarter", "median", "three quarters", "most")
PAGE = "evidence/results/membrane.md"
STORED = Stored(
    "membrane-sensitivity.json", PAGE, lambda kinds: {"expected and found": table(EXPECTED, _expected_rows(kinds))}
)
SAME = Stored(
    "membrane-same-capsule.json", PAGE, lambda kinds: {"same capsule": table(OF_SAME, _same_capsule_rows(kinds))}
)
MAP = Stored("membrane-map.json", PAGE, lambda stored: {"map": table(OF_MAP, _map_rows(stored["quantiles"]))})


def main() -> None:
    parser = with_write(__doc__)
    parser.add_argument("folder", type=Path, help="where finished batches are kept")
    parser.add_argument("--noises", type=int, default=3)
    given = parser.parse_args()
    run(given.folder, given.noises)
    STORED.show(compared(given.folder), write=given.write)
    store = membrane_batches.store_of(given.folder)
    SAME.show({kind: store.load(f"same-capsule-{kind}") for kind in membrane_coverage.KINDS}, write=given.write)
    MAP.show(MAP.read(), write=given.write)


if __name__ == "__main__":
    main()
