"""Drawn pictures for the tests: shapes of the shipped database, and one that is known in closed form."""

import functools

import numpy as np

from capsbayes.database import Database
from evidence.synthetic import Optics, Scene, draw

HALF_WIDTH = 60.0  # px
PLAIN = Optics()


@functools.cache
def shapes():
    return Database.open("square-neo-hookean").converged


def outlines(capillary_number, size_ratio):
    """Profile and silhouette of the case nearest to a point of the database."""
    cases = shapes()
    apart = np.abs(np.log(cases["capillary_number"] / capillary_number))
    row = int(np.argmin(apart + 10.0 * np.abs(cases["size_ratio"] - size_ratio)))
    return cases["profile"][row], cases["silhouette"][row]


def drawn(capillary_number, size_ratio, *, optics=PLAIN, seed=1, **scene):
    """Picture of the case nearest to a point of the database."""
    placed = {"half_width": HALF_WIDTH} | scene
    return draw(Scene(*outlines(capillary_number, size_ratio), **placed), optics, seed=seed)


def dirty(made, at, radius=8.0):
    """The picture of a drawing with a dark speck at a place (x, y)."""
    y, x = np.mgrid[: made.picture.shape[0], : made.picture.shape[1]]
    speck = 1.0 / (1.0 + np.exp((np.hypot(x - at[0], y - at[1]) - radius) / 0.7))
    return np.clip(np.rint(made.picture * (1.0 - 0.5 * speck)), 0, 255).astype(made.picture.dtype)


def circle(radius):
    angle = np.linspace(0.0, 2.0 * np.pi, 720, endpoint=False)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
