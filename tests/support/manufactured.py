"""Manufactured maps: closed forms that stand in for steady shapes where a test needs the truth. Not physics."""

from __future__ import annotations

import numpy as np

from capsbayes.database import Database

POINTS = 64
MESH_ERROR = '{"axial_extent": 0.002, "axial_length": 0.001, "velocity_ratio": 0.0005}'
ATTRIBUTES = {
    "title": "manufactured",
    "source": "closed forms, no physics",
    "law": "manufactured",
    "cross_section": "square",
    "bending": 2e-4,
    "pre_inflation": 0.0,
    "effect": "none",
    "null_value": 0.0,
    "settings": "{}",
    "version": "0",
    "created": "1970-01-01T00:00:00",
}


def limit(size_ratio):
    """Manufactured limit of existence."""
    return np.minimum(0.15, 0.13 - 0.25 * (np.asarray(size_ratio) - 0.9))


def lengths(ca, size):
    """Manufactured (L_z, L_a, v_o/U, Lambda), smooth and with a smooth inverse : (n, 4) array."""
    depth = 1.1 * size * ca**0.6
    axial_length = 2 * size * (1 + 0.8 * (size - 0.8)) * (1 - 0.5 * ca**0.5)
    velocity = 2.1 - 1.0 * size**1.5 + 0.9 * ca * size
    return np.stack([axial_length + depth, axial_length, velocity, 1 + 0.9 * ca * size + 0.1 * (size - 0.7)], axis=-1)


def outlines(ca, size):
    """Manufactured outlines of the wanted extent, an ellipse : (n, POINTS, 2) array."""
    angle = 2 * np.pi * np.arange(POINTS) / POINTS
    extent = lengths(ca, size)[:, :1]
    return np.stack([extent / 2 * np.cos(angle), (0.9 - 0.5 * ca[:, None]) * np.sin(angle)], axis=-1)


def cases(columns=19, rows=16):
    """Rough grid in columns of a/l, denser at low Ca, up to the limit : Ca (c,), a/l (c,)."""
    size = np.linspace(0.70, 1.15, columns)
    ca = [np.geomspace(0.01 + 0.01 * max(0.0, s - 1), limit(s), rows) for s in size]
    return np.concatenate(ca), np.repeat(size, rows)


def two_branches():
    """Database whose shapes jump, at a/l > 1 and Ca < 0.03, to convex ones of one length : L_z = L_a."""
    plain = database()
    ca, size = plain["capillary_number"], plain["size_ratio"]
    convex = is_convex(ca, size)
    dataset = plain.dataset.copy(deep=True)
    for name, values in convex_lengths(ca, size).items():
        dataset[name].values[convex] = values[convex]
    return Database(dataset)


def is_convex(ca, size):
    return (size > 1.01) & (ca < 0.03)


def convex_lengths(ca, size):
    """Manufactured lengths of the convex branch."""
    extent = 2.1 * size * (1 + ca)
    return {
        "axial_extent": extent,
        "axial_length": extent,
        "parachute_depth": np.zeros_like(extent),
        "velocity_ratio": 1.9 - 0.9 * size**1.5 + ca * size,
        "stretch_ratio": 1 + 0.5 * ca,
    }


def database(columns=19, rows=16, *, failed=(), **attributes):
    """Database over the manufactured map; the rows in `failed` did not converge."""
    ca, size = cases(columns, rows)
    values, count = lengths(ca, size), len(ca)
    status = np.full(count, "DONE", dtype="U32")
    status[list(failed)] = "NO_STEADY_STATE"
    border = np.linspace(0.70, 1.15, columns)
    zeros = np.zeros(count)
    variables = {
        "capillary_number": ca,
        "size_ratio": size,
        "effect_value": zeros,
        "axial_extent": values[:, 0],
        "axial_length": values[:, 1],
        "parachute_depth": values[:, 0] - values[:, 1],
        "velocity_ratio": values[:, 2],
        "stretch_ratio": values[:, 3],
        "perimeter": values[:, 3] * 2 * np.pi * size,
        "status": status,
        "nodes": np.zeros((count, 1, 3)),
        "profile": outlines(ca, size),
        "silhouette": outlines(ca, size),
        "border_size_ratio": border,
        "border_capillary_number": limit(border),
        "border_effect_value": np.zeros(columns),
        "border_kind": np.where(limit(border) < 0.15, "limit of existence", "limit of the database"),
        "iterations": np.zeros(count, dtype=int),
        "refinement": np.full(count, 8),
    }
    for name in ("inner_pressure", "extra_pressure_drop", "residual", "slack", "minimum_tension", "wrinkling_rate"):
        variables[name] = zeros
    return Database.assemble(variables, {**ATTRIBUTES, **attributes})


def database_file(folder):
    """Return the file of the database, written to a folder."""
    path = folder / "manufactured.nc"
    database().write(path)
    return path


def capsule_file(folder, experiment):
    """Return the file of a capsule that the database has at Ca = 0.06, a/l = 0.9, with the text of its experiment."""
    extent, length = lengths(0.06, 0.9)[:2]
    (folder / "channel.toml").write_text(experiment)
    path = folder / "capsule.toml"
    path.write_text(
        'experiment = "channel.toml"\n[measurement]\n'
        f'axial_extent = "{extent:.4f} +/- 0.01"\naxial_length = "{length:.4f} +/- 0.01"\n'
        'capsule_velocity = "6.20 +/- 0.06 mm/s"\n'
    )
    return path
