"""Lengths and silhouettes measured under the faults of a recording.

Run ``python -m evidence.benchmarks.conditions [COUNT]``. Capsules 0 to 99 are those on which limits and errors were set
(``--first 0``); those counted follow. ``--keep FILE`` keeps what was measured of each capsule, so that an interrupted
run goes on there. ``--write`` renews ``evidence/results/conditions.json`` and the table in
``evidence/results/pictures.md``, where it is described.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from capsbayes import Database
from capsbayes.image.detect import Detection
from capsbayes.image.files import Picture
from capsbayes.image.measure import detect, silhouette_of
from evidence.benchmarks.camera import MARGIN, Camera, Capsule, Grey, Looks, View, beside, photograph
from evidence.benchmarks.counts import LEVELS, NORMAL_ENDS
from evidence.benchmarks.silhouettes import residuals
from evidence.benchmarks.stored import Stored, completed, with_write
from evidence.markdown import table

HALF_WIDTH = 60.0  # px
FRESH = 100  # number of the first capsule on which nothing was set
HEAD = (
    *("condition", "measured", "refused", "L_z: bias, px", "scatter", "error", "in 68 %", "in 95 %"),
    *("L_a: n", "bias, px", "in 68 %", "in 95 %", "misfit"),
)

Change = Callable[[View, Camera, np.random.Generator], tuple[View, Camera]]


def camera(**changes: Any) -> Change:
    """Return a change of the camera."""
    return lambda view, camera, random: (view, replace(camera, **changes))


def faint(share: float) -> Change:
    """Return a change that leaves a share of the darkness of the capsule."""
    names = ("interior", "membrane", "rear", "halo")

    def changed(view: View, camera: Camera, random: np.random.Generator) -> tuple[View, Camera]:
        fainter = {name: share * getattr(view.looks, name) for name in names}
        return replace(view, looks=replace(view.looks, **fainter)), camera

    return changed


def looks(**changes: float) -> Change:
    """Return a change of capsule or channel."""
    return lambda view, camera, random: (replace(view, looks=replace(view.looks, **changes)), camera)


def overlapping(view: View, camera: Camera, random: np.random.Generator) -> tuple[View, Camera]:
    """Add a second capsule that overlaps the first by a tenth to nine tenths of its length."""
    along, across = random.uniform(0.1, 0.9) * view.axial_extent, random.uniform(-0.1, 0.1) * view.half_width
    first, (rows, columns) = view.capsules[0], view.shape
    moved = replace(first, centre=(first.centre[0] + along, first.centre[1]))
    wider = replace(view, capsules=(moved,), shape=(rows, columns + 2 * int(along)))
    return beside(wider, along, across), camera


def rings(random: np.random.Generator) -> dict[str, float]:
    """Return the looks of rings of 4 to 7 px and any phase."""
    return {"ring": random.uniform(4.0, 7.0), "ring_phase": random.uniform(0.0, 2.0 * np.pi)}


def ringed(view: View, camera: Camera, random: np.random.Generator) -> tuple[View, Camera]:
    """Add rings of 4 to 7 px and any phase in a halo of a tenth to a quarter of the light; blur by 0.7 to 2 px."""
    looks = replace(view.looks, halo=random.uniform(0.1, 0.25), **rings(random), halo_width=random.uniform(1.5, 4.0))
    return replace(view, looks=looks), replace(camera, blur=random.uniform(0.7, 2.0))


def line(least: float, most: float) -> Change:
    """Return a change that shows the membrane as a line, 2 to 6 px broad; inside it is darker by so much."""

    def changed(view: View, camera: Camera, random: np.random.Generator) -> tuple[View, Camera]:
        half, inside = random.uniform(1.0, 3.0), random.uniform(least, most)
        return looks(line=half, interior=inside, rear=view.looks.membrane, rear_width=half)(view, camera, random)

    return changed


def clear(view: View, camera: Camera, random: np.random.Generator) -> tuple[View, Camera]:
    """Fill the capsule with a liquid that is almost as bright as that around it."""
    return looks(interior=random.uniform(0.0, 0.04))(view, camera, random)


def droplet(view: View, camera: Camera, random: np.random.Generator) -> tuple[View, Camera]:
    """Darken the inside alone, by 4 % of the light, in noise of 1 %."""
    faintest = replace(view.looks, interior=0.04, membrane=0.0, rear=0.0, halo=0.0)
    return replace(view, looks=faintest), replace(camera, photons=1e4, constant_noise=0.0)


PLAIN = camera()
CONDITIONS: dict[str, Change] = {
    "none": PLAIN,
    "motion 1 px": camera(motion=1.0),
    "motion 3 px": camera(motion=3.0),
    "motion 6 px": camera(motion=6.0),
    "motion 12 px": camera(motion=12.0),
    "blur 2 px": camera(blur=2.0),
    "blur 3 px": camera(blur=3.0),
    "blur 4 px": camera(blur=4.0),
    "defocus, disc of radius 3 px": camera(defocus=3.0),
    "defocus, disc of radius 6 px": camera(defocus=6.0),
    "defocus, disc of radius 8 px": camera(defocus=8.0),
    "noise 2 %": camera(constant_noise=0.02),
    "noise 5 %": camera(constant_noise=0.05),
    "JPEG 90": camera(jpeg=90),
    "JPEG 75": camera(jpeg=75),
    "JPEG 50": camera(jpeg=50),
    "JPEG 25": camera(jpeg=25),
    "median of 3 x 3 px": camera(median=3),
    "median of 5 x 5 px": camera(median=5),
    "a third of the contrast": faint(0.33),
    "a fifth of the contrast": faint(0.2),
    "a droplet, 4 % darker": droplet,
    "as bright inside as outside": clear,
    "halo 15 %": looks(halo=0.15),
    "rings of light": ringed,
    "the membrane as a line": line(0.0, 0.04),
    "the same, darker inside": line(0.1, 0.3),
    "two capsules overlap": overlapping,
}


class Taken(NamedTuple):
    """A picture with the empty channel, and what stood before the camera."""

    view: View
    picture: Grey
    empty: Grey


def taken(cases: Database, number: int, names: Iterable[str], optics: Change = PLAIN) -> Iterable[tuple[str, Taken]]:
    """Return the pictures of one capsule, drawn at random by its number, in some optics under some conditions."""
    random = np.random.default_rng([2026, number])
    view, plain = optics(*scenery(cases, random), np.random.default_rng([5, number]))
    for name in names:
        shown, chosen = CONDITIONS[name](view, plain, np.random.default_rng([7, number]))
        yield name, Taken(shown, *photograph(shown, chosen, seed=number))


def scenery(cases: Database, random: np.random.Generator) -> tuple[View, Camera]:
    """Return a capsule, a place, looks and a camera at random."""
    case = int(random.integers(len(cases)))
    silhouette = cases["silhouette"][case]
    columns = int(HALF_WIDTH * np.ptp(silhouette[:, 0]) + 2.0 * MARGIN + random.integers(8, 40))
    columns = max(columns, 200)
    centre = 0.5 * columns + random.uniform(-4.0, 4.0), 99.5 + random.uniform(-4.0, 4.0)
    drawn = drawn_looks(random)
    view = View(
        (Capsule(cases["profile"][case], silhouette, centre),),
        HALF_WIDTH,
        (200, columns),
        tilt=random.uniform(-0.03, 0.03),
        flow=int(random.choice([-1, 1])),
        looks=drawn,
    )
    return view, drawn_camera(random)


def drawn_looks(random: np.random.Generator) -> Looks:
    """Return the looks of capsule and channel in one microscope, at random."""
    return Looks(
        interior=random.uniform(0.1, 0.3),
        membrane=random.uniform(0.25, 0.5),
        membrane_width=random.uniform(3.0, 6.0),
        rear=random.uniform(0.2, 0.45),
        rear_width=random.uniform(1.5, 3.5),
        halo=random.uniform(0.0, 0.08),
        halo_width=random.uniform(1.5, 4.0),
        wall=random.uniform(0.4, 0.6),
        wall_width=random.uniform(1.5, 3.0),
        beyond=random.uniform(0.85, 1.0),
        unevenness=random.uniform(-0.1, 0.1),
    )


def drawn_camera(random: np.random.Generator) -> Camera:
    """Return a good camera at random."""
    return Camera(blur=random.uniform(0.5, 1.0), photons=10.0 ** random.uniform(3.7, 4.5))


def measured(shot: Taken) -> Detection:
    """Return what is detected in a picture."""
    return detect(Picture.from_array(shot.picture), background=Picture.from_array(shot.empty))


def row(shot: Taken, seen: Detection) -> dict[str, Any]:
    """Return the status, the errors of L_z and L_a with the stated ones [px], and the misfit of the silhouette.

    The misfit is the mean square of its residuals over the stated covariance, 1 if that is right.
    """
    made: dict[str, Any] = {"status": seen.status.name}
    if seen.status.ok:
        sd = np.sqrt(np.diag(seen.covariance))
        made["L_z"] = [float(seen.lengths[0] - shot.view.axial_extent), float(sd[0])]
        if seen.rear is not None:
            made["L_a"] = [float(seen.lengths[1] - shot.view.axial_length), float(sd[1])]
        if (outline := silhouette_of(seen)) is not None:
            made["misfit"] = float(np.mean(residuals(outline, shot.view.capsules[0].silhouette).white ** 2))
    return made


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the numbers of a condition."""
    statuses = Counter(row["status"] for row in rows)
    made: dict[str, Any] = {"pictures": len(rows), "statuses": dict(statuses.most_common())}
    for name in ("L_z", "L_a"):
        pairs = np.array([row[name] for row in rows if name in row])
        if len(pairs):
            error, sd = pairs.T
            made[name] = {
                "n": len(error),
                "bias": float(error.mean()),
                "median": float(np.median(error)),
                "scatter": float(error.std()),
                "largest": float(np.abs(error).max()),
                "error": float(np.sqrt(np.mean(sd**2))),
                "inside": {f"{level}%": int(np.sum(np.abs(error) < end * sd)) for level, end in NORMAL_ENDS.items()},
            }
    misfits = [row["misfit"] for row in rows if "misfit" in row]
    if misfits:
        made["misfit"] = {"median": float(np.median(misfits)), "90 %": float(np.quantile(misfits, 0.9))}
    return made


def tables(stored: dict[str, Any]) -> dict[str, str]:
    """Return the table, a row for each condition."""
    return {"conditions": table(HEAD, ((name, *_cells(numbers)) for name, numbers in stored.items()))}


def _cells(numbers: dict[str, Any]) -> list[str]:
    refused = [f"{name} {count}" for name, count in numbers["statuses"].items() if name != "DONE"]
    cells = [str(numbers["statuses"].get("DONE", 0)), ", ".join(refused)]
    for name, count in (("L_z", 5), ("L_a", 4)):
        if length := numbers.get(name):
            of_l_z = f"{length['bias']:+.2f}", f"{length['scatter']:.2f}", f"{length['error']:.2f}"
            cells += of_l_z if name == "L_z" else (str(length["n"]), f"{length['bias']:+.2f}")
            cells += [f"{length['inside'][f'{level}%'] / length['n']:.0%}" for level in LEVELS]
        else:
            cells += [""] * count
    misfit = numbers.get("misfit")
    return [*cells, f"{misfit['median']:.2g} ({misfit['90 %']:.2g})" if misfit else ""]


STORED = Stored("conditions.json", "evidence/results/pictures.md", tables)


def rows(cases: Database, number: int, names: list[str]) -> dict[str, dict[str, Any]]:
    """Return what was measured of a capsule under each condition."""
    return {name: row(shot, measured(shot)) for name, shot in taken(cases, number, names)}


def main() -> None:
    parser = with_write(__doc__)
    parser.add_argument("count", nargs="?", type=int, default=10, help="number of capsules (default: 10)")
    parser.add_argument("--first", type=int, default=FRESH, help=f"number of the first (default: {FRESH})")
    parser.add_argument("--keep", type=Path, help="file of what was measured, from which an interrupted run goes on")
    parser.add_argument("--only", default="", help="conditions whose name contains this")
    given = parser.parse_args()
    names = [name for name in CONDITIONS if given.only in name]
    cases, numbers = Database.open("square-neo-hookean").converged, range(given.first, given.first + given.count)
    done = completed(given.keep, ((str(n), partial(rows, cases, n, names)) for n in numbers))
    made = {name: summary([done[str(number)][name] for number in numbers]) for name in names}
    STORED.show(made, write=given.write)


if __name__ == "__main__":
    main()
