"""Inputs drawn with fixed seeds from the shapes that are stored in `data/`, read without the package.

They are files, as a user has them: a capsule in TOML with its outline in CSV, a table, a picture, a contour.
"""

from __future__ import annotations

import csv
import functools
from pathlib import Path
from typing import Any

import numpy as np
from environment import REPOSITORY
from numpy.typing import NDArray

Floats = NDArray[np.float64]

HALF_WIDTH, VISCOSITY, MODULUS = 25e-6, 0.8, 50e-3
"""Of the drawn capsules, in SI."""

ERROR = 0.01
"""Of lengths over l and of velocities over themselves."""

_SAID = ("capillary_number", "size_ratio", "effect_value", "axial_extent", "axial_length", "velocity_ratio")


@functools.cache
def shapes(name: str) -> dict[str, Any]:
    """Converged cases of a database in `data/databases`, or of a pool, as ``pools/none-0``."""
    import xarray as xr

    path = REPOSITORY / "data" / (f"{name}.nc" if "/" in name else f"databases/{name}.nc")
    with xr.open_dataset(path, engine="h5netcdf") as file:
        done = np.flatnonzero(file["status"].values.astype(str) == "DONE")
        return {one: file[one].values[done] for one in (*_SAID, "profile", "silhouette") if one in file}


def case(name: str, ca: float, size: float, effect: float | None = None) -> dict[str, Any]:
    """The case of a database next to a place."""
    cases = shapes(name)
    apart = np.abs(np.log(cases["capillary_number"] / ca)) + 10.0 * np.abs(cases["size_ratio"] - size)
    if effect is not None:
        values = cases["effect_value"]
        apart += 1e3 * np.abs(values - effect) / np.ptp(values)
    row = int(np.argmin(apart))
    return {one: values[row] for one, values in cases.items()}


def measured(one: dict[str, Any], rng: np.random.Generator, *, error: float = ERROR) -> dict[str, float]:
    """Lengths over l and velocity of a case, with errors drawn."""
    extent = float(one["axial_extent"]) + error * float(rng.standard_normal())
    length = float(one["axial_length"]) + error * float(rng.standard_normal())
    flow = MODULUS * float(one["capillary_number"]) / VISCOSITY
    velocity = flow * float(one["velocity_ratio"]) * (1.0 + ERROR * float(rng.standard_normal()))
    return {"extent": extent, "length": min(length, extent), "velocity": velocity, "error": error}


def experiment_file(path: Path, *, section: str = "square", exact: bool = False) -> Path:
    """Write the file of an experiment."""
    width, viscosity = ("25.0 um", "0.8 Pa s") if exact else ("25.0 +/- 0.2 um", "0.80 +/- 0.02 Pa s")
    path.write_text(f'section = "{section}"\nhalf_width = "{width}"\nviscosity = "{viscosity}"\n')
    return path


def capsule_file(
    path: Path,
    one: dict[str, Any],
    *,
    seed: int,
    experiment: Path,
    length: bool = True,
    view: str | None = None,
    error: float = ERROR,
    metres: bool = False,
    more: str = "",
) -> Path:
    """Write the file of a capsule, and its outline next to it if a view is named."""
    rng = np.random.default_rng([20, seed])
    seen = measured(one, rng, error=error)
    scale, unit = (HALF_WIDTH, " m") if metres else (1.0, "")
    lines = [f'experiment = "{experiment.name}"', "", "[measurement]"]
    for name, there in (("extent", True), ("length", length)):
        if there:
            lines.append(f'axial_{name} = "{scale * seen[name]!r} +/- {scale * error!r}{unit}"')
    lines.append(f'capsule_velocity = "{seen["velocity"]!r} +/- {ERROR * seen["velocity"]!r} m/s"')
    if view is not None:
        outline = path.with_suffix(".outline.csv")
        points_file(outline, outlined(one["profile" if view == "section" else "silhouette"], rng))
        lines += ["", "[outline]", f'file = "{outline.name}"', "noise = 0.01", "correlation = 0.2", "white = 0.2"]
        lines += [f'view = "{view}"'] if view != "section" else []
    path.write_text("\n".join(lines) + "\n" + more)
    return path


def outlined(points: Floats, rng: np.random.Generator, *, error: float = ERROR, every: int = 3) -> Floats:
    """Some points of an outline, moved by smooth and by independent errors."""
    points = np.asarray(points, dtype=np.float64)
    tangent = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    length = np.hypot(*tangent.T)[:, None]
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1) / np.where(length > 0.0, length, 1.0)
    place = np.linspace(0.0, 2.0 * np.pi, len(points), endpoint=False)
    waves = np.arange(1, 9)
    smooth = rng.standard_normal(8) @ np.cos(waves[:, None] * place + rng.uniform(0.0, 2.0 * np.pi, (8, 1)))
    moved = error * (0.45 * smooth / 2.0 + 0.45 * rng.standard_normal(len(points)))
    return (points + moved[:, None] * normal)[::every]


def points_file(path: Path, points: Floats) -> None:
    """Write an outline as a table of its points."""
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["z_over_l", "y_over_l"])
        rows.writerows([[repr(float(z)), repr(float(y))] for z, y in points])


def table_file(path: Path, count: int, *, seed: int) -> Path:
    """Write a table of lengths: most capsules with both, some with one, some on the border, some not to be used."""
    rng = np.random.default_rng([30, seed])
    cases = shapes("square-neo-hookean")
    columns = ["name", "axial_extent_over_l", "axial_extent_error_over_l", "capsule_velocity_m_per_s"]
    columns += ["capsule_velocity_error_m_per_s", "axial_length_over_l", "axial_length_error_over_l"]
    columns += ["length_correlation", "half_width_um", "viscosity_pa_s"]
    with path.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(columns)
        for number in range(count):
            row = int(rng.integers(len(cases["size_ratio"])))
            error = ERROR * float(rng.choice([0.5, 1.0, 2.0]))
            seen = measured({one: values[row] for one, values in cases.items()}, rng, error=error)
            length = (repr(seen["length"]), repr(error)) if number % 4 else ("", "")
            if number % 97 == 96:
                seen["extent"] = 9.0
            other = (24.0, 0.75) if number % 10 == 7 else (25.0, 0.8)
            speed = (repr(seen["velocity"]), repr(ERROR * seen["velocity"]))
            correlation = 0.5 if number % 3 else 0.0
            rows.writerow([f"c{number:03d}", repr(seen["extent"]), repr(error), *speed, *length, correlation, *other])
    return path


def contour_file(path: Path, points: Floats, *, pixels: float, seed: int) -> Path:
    """Write a contour in pixels."""
    moved = outlined(points, np.random.default_rng([40, seed]), error=0.003, every=1)
    np.savetxt(path, pixels * moved + [200.3, 80.7], fmt="%.4f", delimiter=",", header="x_px,y_px", comments="")
    return path


def rtdc_file(path: Path) -> Path:
    """Write two events of a sphere with a dark rim between walls, and one whose mask is in two pieces."""
    import h5py
    from scipy.special import erfc

    rng = np.random.default_rng(50)
    half_width = 10.0 / 0.34
    rows, columns = np.mgrid[:80, :160].astype(np.float64)
    beyond = np.abs(rows - 39.5) - half_width
    channel = 200.0 - (14.0 + 110.0 * np.exp(-np.abs(beyond) / 2.5)) * 0.5 * erfc(-beyond)
    pictures, masks = [], []
    for middle in (40.0, 80.3, 120.0):
        away = np.hypot(columns - middle, rows - 39.5) - 0.6 * half_width
        grey = channel * (1.0 - (0.25 + 0.3 * np.exp(-np.abs(away) / 5.0)) * 0.5 * erfc(away))
        pictures.append(np.clip(np.rint(grey + 2.0 * rng.standard_normal(grey.shape)), 0, 255).astype(np.uint8))
        masks.append(away < 0.0)
    masks[2][:, 118:121] = False
    with h5py.File(path, "w") as file:
        file.attrs["imaging:pixel size"], file.attrs["setup:channel width"] = 0.34, 20.0
        file["events/image"] = np.stack(pictures)
        file["events/mask"] = 255 * np.stack(masks).astype(np.uint8)
    return path
