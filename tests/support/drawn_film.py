"""Drawn films: capsules that move through a channel, drawn without noise once and exposed with many."""

import functools
from dataclasses import replace

import cv2
import numpy as np
from drawn import PLAIN, outlines

from evidence.synthetic import Scene, draw

SHAPE, HALF_WIDTH = (118, 330), 45.0
ELECTRONS = 10_000.0


@functools.cache
def bright(capillary_number=0.06, size_ratio=1.0, half_width=HALF_WIDTH, x=None, flow=1, tilt=0.0, across=0.0):
    """Grey levels of a frame without noise, and of the empty channel; `x` is where the capsule's middle is."""
    middle = np.array([(SHAPE[1] - 1) / 2, (SHAPE[0] - 1) / 2])
    centre = middle + (x - middle[0]) * np.array([1.0, np.tan(tilt)]) + [0.0, across]
    shape = outlines(capillary_number, size_ratio)
    scene = Scene(*shape, half_width, SHAPE, centre=tuple(centre), flow=flow, tilt=tilt)
    return draw(scene, replace(PLAIN, electrons=1e8), seed=1)


def exposed(grey, seed, electrons=ELECTRONS):
    """Shot noise on grey levels of which 200 are the full light."""
    counted = np.random.default_rng(seed).poisson(grey * electrons / 200.0) * 200.0 / electrons
    return np.clip(np.rint(counted), 0, 255).astype(np.uint8)


def film(places, seed=0, electrons=ELECTRONS, **scene):
    """Frames with a capsule at each of some places, or with several at rows of places."""
    frames = []
    for number, row in enumerate(np.reshape(places, (len(places), -1))):
        made = [bright(x=float(x), **scene) for x in row]
        grey = made[0].background.astype(float)
        for one in made:
            grey = grey * one.picture / np.maximum(one.background, 1.0)
        frames.append(exposed(grey, [seed, number], electrons))
    return frames


def written(folder, frames):
    folder.mkdir()
    for number, frame in enumerate(frames):
        cv2.imwrite(str(folder / f"frame{number}.png"), frame)
    return folder
