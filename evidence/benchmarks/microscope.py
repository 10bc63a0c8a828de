"""Lengths and G_s from pictures as lenses make them, of light that is absorbed and delayed.

Run ``python -m evidence.benchmarks.microscope [COUNT]``. ``--keep FILE`` keeps what was measured in each picture, so
that an interrupted run goes on there. ``--write`` renews ``evidence/results/microscope.json`` and the table in
``evidence/results/pictures.md``, where it is described. The random numbers of a picture are those of its condition and
its number, so that any part of the table can be drawn again.

The capsule is a thin element, which multiplies the field of a plane wave. Waves from all over the condenser pass the
pupil of the lens one after the other, out of focus or not; their intensities add up on the pixels (Abbe's sum). Nothing
is shared with what measures the pictures, nor with ``camera``, whose membranes and halos are painted. Lengths are in
pixels unless they are said to be in the half width l or in micrometres.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.interpolate import CubicSpline
from scipy.spatial import cKDTree

from capsbayes import Database, Surrogate
from capsbayes.errors import InputError
from capsbayes.image.files import Picture
from capsbayes.image.measure import detect, measurement_of, turned
from capsbayes.quantity import Quantity
from evidence.benchmarks import conditions
from evidence.benchmarks.counts import LEVELS, percent
from evidence.benchmarks.picture_moduli import EXPERIMENT, FLOW, OF_VELOCITY, VISCOSITY, counts_of, told
from evidence.benchmarks.stored import POOL_FOLDER, Stored, completed, with_write
from evidence.exam.sessions import read_pool
from evidence.markdown import table

Floats = NDArray[np.float64]
Grey = NDArray[np.uint8]

FINE = 4  # samples of the field along the side of a pixel
SEEN = 3  # samples of the light along the side of a pixel
AROUND = 24  # px about the picture
WAVELENGTH = 0.55  # µm
WATER = 1.33  # refractive index
HALF_WIDTH = 25.0  # µm
SHELL = 0.4  # thickness of a membrane that is a thin shell
MODULUS = "surface_shear_modulus"
HEAD = (
    *("condition", "measured", "refused", "L_z: bias, px", "scatter", "error", "in 68 %, 95 %"),
    *("L_a: n", "bias, px", "in 95 %", "G_s: n", "refused by the fit", "in 68 %, 95 %", "ln G_s: sd, error"),
)

Range = tuple[float, float]

LOOKS: dict[str, Range] = {  # of capsule and walls; densities are optical
    "inside": (0.1, 0.28),  # share of the light that is absorbed on its way through the capsule
    "delay": (0.0, 0.003),  # refractive index inside minus outside, of either sign
    "band": (0.25, 0.6),  # density of the membrane at the edge; it falls inwards
    "band_width": (1.2, 3.0),  # depth at which it has fallen to 1/e
    "rear": (0.25, 0.6),  # density of the membrane of a concave rear
    "rear_width": (0.9, 1.6),  # standard deviation
    "shell": (0.02, 0.06),  # density of the two sides, seen face on, of a membrane that is a thin shell
    "wall": (0.7, 1.1),
    "wall_width": (1.5, 2.5),  # standard deviation
    "beyond": (0.0, 0.1),  # density beyond the walls
}
MICROSCOPE: dict[str, Range] = {
    "aperture": (0.3, 0.45),  # numerical, of the lens
    "condenser": (0.12, 0.2),  # numerical aperture of the light, at most that of the lens
    "defocus": (0.0, 1.0),  # µm, to either side
    "log_photons": (3.7, 4.4),  # decimal logarithm of those counted by a pixel at the full light
    "full_light": (150.0, 205.0),  # its grey level
    "down": (-0.05, 0.05),  # light gained from the middle to the last row
    "right": (-0.05, 0.05),  # and to the last column
}
SIGNED = ("delay", "defocus")
NOISE = 0.004  # standard deviation of the noise in the dark, over the full light
INCOHERENT: dict[str, Range] = {"condenser": (1.0, 1.0)}
PROJECTED = (
    "a thin shell, incoherent",
    "no membrane",
    "a thin shell alone",
)  # not painted: no band, no line of the rear
CONDITIONS: dict[str, dict[str, Range]] = {  # what differs from the ranges above
    "in focus, incoherent": INCOHERENT,
    "in focus, partly coherent": {},
    "a sharp lens": {"aperture": (0.5, 0.7), "condenser": (0.3, 0.3)},
    "a thin shell, incoherent": INCOHERENT,
    "no membrane": {"shell": (0.0, 0.0)},
    "out of focus by 1.5 to 3.5 µm": {"defocus": (1.5, 3.5)},
    "out of focus by 4 to 10 µm": {"defocus": (4.0, 10.0)},
    "mild rings": {"delay": (0.001, 0.002), "condenser": (0.05, 0.09), "defocus": (1.5, 4.0)},
    "strong rings": {"delay": (0.002, 0.005), "condenser": (0.02, 0.05), "defocus": (4.0, 10.0)},
    "a thin shell alone": {"inside": (0.0, 0.0), "delay": (0.0, 0.001), "shell": (0.03, 0.07)},
}


@dataclass(frozen=True, eq=False)
class View:
    """A capsule in its channel, and the microscope."""

    silhouette: Floats  # outline (p, 2) as seen from the side [l]; columns (z, y), z along the flow, from the nose on
    profile: Floats  # outline in the plane of the axis
    half_width: float
    shape: tuple[int, int]  # rows and columns of the picture
    middle: tuple[float, float]  # of the capsule along and across the channel, from the middle of the picture
    flow: int  # 1 to the right, -1 to the left
    tilt: float  # of the channel to the rows
    values: dict[str, float]  # of LOOKS and MICROSCOPE
    projected: bool  # as a body, with a membrane of one thickness; or else painted


class Body:
    """Capsule whose outline is a silhouette and whose rear is hollow as in the plane of the axis; lengths over l.

    It is the silhouette ahead of the rim and the dent behind it, turned about the axis. As the rim is not in one plane,
    what is near it is shifted along the axis until it ends where the silhouette does.
    """

    def __init__(self, silhouette: Floats, profile: Floats) -> None:
        half = len(profile) // 2 + 1
        side, plane = silhouette[:half], profile[:half]
        hindmost, widest = int(np.argmin(plane[:, 0])), int(np.argmax(side[:, 1]))
        last = widest + int(np.argmin(np.abs(side[widest:, 1] - plane[hindmost, 1])))
        self.rim = side[last]
        self.behind = side[last:][::-1] - [self.rim[0], 0.0]  # from the axis to the rim
        self.dent = plane[hindmost:] * [1.0, self.rim[1] / plane[hindmost, 1]]
        self.dent[:, 0] += np.linspace(self.rim[0] - self.dent[0, 0], 0.0, len(self.dent))
        self.curve = _even(np.vstack([side[: last + 1], self.dent[1:]]))
        along = np.gradient(self.curve, axis=0)
        self.normals = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]

    def chord(self, z: Floats, y: Floats, outwards: float = 0.0) -> Floats:
        """Return the way of the light within the body, whose surface is moved outwards."""
        curve, off = self.curve + outwards * self.normals, np.abs(y)
        near = np.exp(-np.square((z - self.rim[0]) / (0.33 * (self.dent[-1, 0] - self.rim[0]))))
        z = z - near * np.interp(off, self.behind[:, 1], self.behind[:, 0], right=0.0)
        rim = int(np.argmin(curve[:, 0]))
        outer, hollow = (
            np.interp(z, np.maximum.accumulate(branch[:, 0]), np.maximum(branch[:, 1], 0.0), left=0.0, right=0.0)
            for branch in (curve[: rim + 1][::-1], curve[rim:])
        )
        whole, part = (np.sqrt(np.maximum(radius**2 - off**2, 0.0)) for radius in (outer, hollow))
        return np.asarray(2.0 * np.maximum(whole - part, 0.0))


def photograph(view: View, random: np.random.Generator) -> tuple[Grey, Grey]:
    """Return the picture of a view, and that of its channel empty : (rows, columns) arrays."""
    y, x = ((np.arange(FINE * n) + 0.5) / FINE - 0.5 * n for n in (count + 2 * AROUND for count in view.shape))
    cosine, sine = np.cos(view.tilt), np.sin(view.tilt)
    along, across = cosine * x + sine * y[:, None], cosine * y[:, None] - sine * x
    beyond, values = np.abs(across) - view.half_width, view.values
    walls = values["wall"] * np.exp(-0.5 * np.square(beyond / values["wall_width"])) + values["beyond"] * (beyond > 0.0)
    empty = np.exp(-0.5 * walls)
    return recorded(empty * passing(view, along, across), view, random), recorded(empty, view, random)


def passing(view: View, along: Floats, across: Floats) -> NDArray[np.complex128]:
    """Return the factor by which a capsule changes the field, at places along and across the channel."""
    ends, unit = view.silhouette[:, 0], view.half_width
    z = view.flow * (along - view.middle[0]) / unit + 0.5 * (ends.max() + ends.min())
    y = (across - view.middle[1]) / unit
    near = (z > ends.min() - 2.0 / unit) & (z < ends.max() + 2.0 / unit) & (np.abs(y) < 1.0)
    points = np.stack([z[near], y[near]], axis=1)
    body = Body(view.silhouette, view.profile)
    density = (projected if view.projected else painted)(view, body, points)
    phase = 2.0 * np.pi / WAVELENGTH * view.values["delay"] * HALF_WIDTH * body.chord(*points.T)
    field = np.ones(z.shape, dtype=complex)
    field[near] = np.exp(1j * phase - 0.5 * density)
    return field


def projected(view: View, body: Body, points: Floats) -> Floats:
    """Return the density at points (z, y) [l] of a body in a membrane of one thickness."""
    step = 0.5 * SHELL / view.half_width
    inside = -np.log1p(-view.values["inside"]) / body.chord(np.zeros(1), np.zeros(1))
    density = np.zeros(len(points))
    for quarter in np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)]) / (4 * FINE * view.half_width):
        outer, inner = (body.chord(*(points + quarter).T, outwards) for outwards in (step, -step))
        density += 0.25 * (view.values["shell"] * (outer - inner) / (4.0 * step) + inside * inner)
    return density


def painted(view: View, body: Body, points: Floats) -> Floats:
    """Return the density at points (z, y) [l] of a capsule with a dark band inside its edge."""
    values, unit = view.values, view.half_width
    border = _even(np.vstack([view.silhouette, view.silhouette[:1]]))
    away, nearest = cKDTree(border).query(points, distance_upper_bound=8.0 * values["band_width"] / unit)
    depth = np.where(body.chord(*points.T) > 0.0, np.inf, -np.inf)
    met = np.isfinite(away)
    along = (np.roll(border, -1, axis=0) - np.roll(border, 1, axis=0))[nearest[met]]
    step = points[met] - border[nearest[met]]
    depth[met] = unit * (along[:, 0] * step[:, 1] - along[:, 1] * step[:, 0]) / np.hypot(*along.T)
    covered = np.clip(0.5 + FINE * depth, 0.0, 1.0)
    depth = np.maximum(depth, 0.0)
    density = values["band"] * np.exp(-depth / values["band_width"]) - np.log1p(-values["inside"])
    line = _even(np.vstack([body.dent, body.dent[-2::-1] * [1.0, -1.0]]))
    away = unit * cKDTree(line).query(points, distance_upper_bound=6.0 * values["rear_width"] / unit)[0]
    rear = np.exp(-0.5 * np.square(away / values["rear_width"])) * -np.expm1(-depth / 1.5)  # it ends at the rim
    return np.asarray(covered * (density + values["rear"] * rear))


def _even(line: Floats) -> Floats:
    """Return points 0.002 l apart along a line."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    return np.asarray(CubicSpline(way, line)(np.arange(0.0, way[-1], 0.002)))


def imaged(field: NDArray[Any], pixel: float, values: dict[str, float]) -> Floats:
    """Return the light on the pixels, `pixel` µm wide, behind the lens; 1 where the field is."""
    size = np.array(field.shape) // FINE
    unit = pixel / WAVELENGTH  # frequency per pixel of a numerical aperture of 1
    most = np.ceil((values["aperture"] + 0.03) * unit * size).astype(int)
    fy, fx = (np.arange(-end, end + 1) / count for end, count in zip(most, size, strict=True))
    sine = np.hypot(fx, fy[:, None]) / unit
    way = values["defocus"] * np.sqrt(np.maximum(WATER**2 - sine**2, 0.0)) / WAVELENGTH
    between = (
        (fx + fy[:, None]) * 0.5 * (1.0 / SEEN - 1.0 / FINE)
    )  # from the first sample of the field to that of light
    pupil = 0.5 - 0.5 * np.tanh((sine - values["aperture"]) / 0.01)  # a hard border would ring
    pupil = (pupil * np.exp(2j * np.pi * (way + between))).astype(np.complex64)
    rows, columns = (np.arange(-end, end + 1) for end in most)
    spectrum = fft.fftshift(fft.fft2(field.astype(np.complex64)))
    light, waves = np.zeros(SEEN * size), tilts(values["condenser"])
    for wave in waves:
        top, left = np.array(field.shape) // 2 - most + np.rint(wave * unit * size).astype(int)
        passed = np.zeros(light.shape, dtype=np.complex64)
        passed[np.ix_(rows, columns)] = pupil * spectrum[top : top + len(rows), left : left + len(columns)]
        light += np.square(np.abs(fft.ifft2(passed)))
    light *= (SEEN / FINE) ** 4 / len(waves)
    return np.asarray(light.reshape(size[0], SEEN, size[1], SEEN).mean(axis=(1, 3)))


def tilts(condenser: float) -> Floats:
    """Return the waves (sine along y, along x) of a condenser, evenly over its aperture."""
    count = 6 + int(60.0 * condenser)
    order = np.arange(count) + 0.5
    angle = np.pi * (3.0 - np.sqrt(5.0)) * order
    places = condenser * np.sqrt(order / count)[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    return np.asarray(places - places.mean(axis=0))


def recorded(field: NDArray[Any], view: View, random: np.random.Generator) -> Grey:
    """Return the grey levels of a field."""
    values, (rows, columns) = view.values, view.shape
    light = imaged(field, HALF_WIDTH / view.half_width, values)[AROUND : AROUND + rows, AROUND : AROUND + columns]
    light = light * (
        1.0 + values["down"] * np.linspace(-1, 1, rows)[:, None] + values["right"] * np.linspace(-1, 1, columns)
    )
    photons = 10.0 ** values["log_photons"]
    noisy = random.poisson(light * photons) / photons + NOISE * random.standard_normal(light.shape)
    return np.asarray(np.clip(np.rint(values["full_light"] * noisy), 0, 255), dtype=np.uint8)


def scenery(cases: Database, condition: str, number: int) -> tuple[int, View, np.random.Generator]:
    """Return the number of a case, a view of it under a condition, and the random numbers of its exposure."""
    random = np.random.default_rng([zlib.crc32(condition.encode()), number])
    case = int(random.integers(len(cases)))
    half_width = random.uniform(40.0, 75.0)
    values = {name: random.uniform(*ends) for name, ends in (LOOKS | MICROSCOPE | CONDITIONS[condition]).items()}
    values |= {name: random.choice([-1.0, 1.0]) * values[name] for name in SIGNED}
    values["condenser"] = min(values["condenser"], values["aperture"])
    rows = int(2.0 * (half_width + max(0.4 * half_width, 22.0)))
    columns = int(half_width * np.ptp(cases["silhouette"][case][:, 0]) + 2.0 * random.uniform(30.0, 50.0))
    middle = random.uniform(-4.0, 4.0), random.uniform(-0.3, 0.3)
    flow, tilt = int(random.choice([-1, 1])), random.uniform(-0.025, 0.025)
    outlines = cases["silhouette"][case], cases["profile"][case]
    view = View(*outlines, half_width, (rows, columns), middle, flow, tilt, values, condition in PROJECTED)
    return case, view, random


def row(cases: Database, model: Surrogate, condition: str, number: int) -> dict[str, Any]:
    """Return the status of a picture, the errors of its lengths with the stated ones, and what is told of G_s."""
    case, view, random = scenery(cases, condition, number)
    drawn, channel = photograph(view, random)
    picture, empty, _ = turned(Picture.from_array(drawn), Picture.from_array(channel), None)
    try:
        seen = detect(picture, background=empty)
    except InputError:
        return {"status": "the empty channel"}
    ca, ratio = (float(cases[name][case]) for name in ("capillary_number", "velocity_ratio"))
    errors = random.standard_normal(2)
    velocity = Quantity(FLOW * ratio * (1.0 + OF_VELOCITY * errors[0]), OF_VELOCITY * FLOW * ratio, "m/s")
    experiment = replace(EXPERIMENT, half_width=1e-6 * HALF_WIDTH)
    measured = measurement_of(seen, picture, experiment, velocity)
    made: dict[str, Any] = {"status": measured.status.name}
    if measured.status.ok:
        rear = view.profile[len(view.profile) // 2, 0]
        for at, name, end in ((0, "L_z", view.silhouette[:, 0].min()), (1, "L_a", rear)):
            error = seen.lengths[at] - view.half_width * (view.silhouette[:, 0].max() - end)
            if np.isfinite(error):
                made[name] = [float(error), float(np.sqrt(seen.covariance[at, at]))]
        truth = {MODULUS: (VISCOSITY.value + VISCOSITY.error * errors[1]) * FLOW / ca}
        known = measured.outline is not None
        made["G_s"] = told(measured, model, truth, experiment) if known else {"refused": "no silhouette"}
    return made


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the numbers of a condition: of lengths, as in ``conditions``, and of the answers by silhouettes."""
    answers = [one["G_s"] for one in rows if "G_s" in one]
    used = [one for one in answers if "refused" not in one]
    medians = {key: float(np.median([one[key] for one in used])) for key in ("sd", "error") if used}
    return conditions.summary(rows) | {"G_s": counts_of(answers, [MODULUS]) | medians}


def tables(stored: dict[str, Any]) -> dict[str, str]:
    """Return the table, a row for each condition."""
    return {"microscope": table(HEAD, (_cells(name, numbers) for name, numbers in stored.items()))}


def _cells(name: str, numbers: dict[str, Any]) -> list[str]:
    refused = {status: count for status, count in numbers["statuses"].items() if status != "DONE"}
    answers, cells = numbers["G_s"], [name, str(numbers["statuses"].get("DONE", 0)), _listed(refused)]
    if extent := numbers.get("L_z"):
        cells += [f"{extent['bias']:+.2f}", f"{extent['scatter']:.2f}", f"{extent['error']:.2f}"]
    cells += [_shares(extent["inside"], "{}%", extent["n"])] if extent else [""] * 4
    length = numbers.get("L_a")
    cells += [str(length["n"]), f"{length['bias']:+.2f}"] if length else ["0", ""]
    cells += [_shares(length["inside"], "{}%", length["n"], (95,)) if length else "", str(answers["n"])]
    shares = _shares(answers, MODULUS + " {}", answers["n"])
    return [
        *cells,
        _listed(answers["refused"]),
        shares,
        f"{answers['sd']:.2g}, {answers['error']:+.2g}" if shares else "",
    ]


def _listed(counts: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items())


def _shares(counts: dict[str, int], key: str, number: int, levels: tuple[int, ...] = LEVELS) -> str:
    return ", ".join(percent(counts[key.format(level)] / number) for level in levels) if number else ""


STORED = Stored("microscope.json", "evidence/results/pictures.md", tables)


def main() -> None:
    parser = with_write(__doc__)
    parser.add_argument("count", nargs="?", type=int, default=6, help="number of pictures each (default: 6)")
    parser.add_argument("--first", type=int, default=0, help="number of the first (default: 0)")
    parser.add_argument("--keep", type=Path, help="file of what was measured, from which an interrupted run goes on")
    given = parser.parse_args()
    cases = read_pool(POOL_FOLDER, "none", 0.0, "development").converged
    model = Surrogate.open("square-neo-hookean", view="silhouette")
    numbers = range(given.first, given.first + given.count)
    pictures = [(f"{name}, {n}", partial(row, cases, model, name, n)) for name in CONDITIONS for n in numbers]
    done = completed(given.keep, pictures)
    made = {name: summary([done[f"{name}, {n}"] for n in numbers]) for name in CONDITIONS}
    STORED.show(made, write=given.write)


if __name__ == "__main__":
    main()
