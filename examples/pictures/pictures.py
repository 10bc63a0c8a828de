"""Drawn pictures of capsules whose parameters are known: a picture, a film, a traced contour and an .rtdc file.

`--out FOLDER` draws the files that lie next to this script, from the shipped database and a seed; without it the
picture next to this script is measured and identified. The renderer is that of `evidence/benchmarks/camera.py`, which
shares no code with what measures pictures. Reading and writing the .rtdc file needs `pip install ".[rtdc]"`.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from capsbayes import Experiment, Surrogate, identify, measure
from capsbayes.experiment import capillary_number
from capsbayes.quantity import Quantity

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parents[1]))
from evidence.benchmarks.camera import Camera, Capsule, View, film, photograph  # noqa: E402

MODULUS, FLOW, VISCOSITY = 50e-3, 3.75e-3, 0.80  # N/m, m/s, Pa s
RADIUS, RADII_OF_EVENTS = 23.5e-6, (18e-6, 19e-6, 20e-6)  # m
EXPERIMENT = Experiment(
    cross_section="square",
    half_width=Quantity(25e-6, 0.2e-6),
    viscosity=Quantity(VISCOSITY, 0.02),
    frame_rate=Quantity(400.0, 0.0, "1/s"),
)
SHAPE, HALF_WIDTH = (160, 220), 60.0  # px
FILM_SHAPE, FILM_HALF_WIDTH, REACH = (112, 352), 40.0, 51.0  # px; a capsule is whole at this distance from the borders
EVENT_SHAPE, PIXEL = (96, 224), 0.68e-6  # px, m
CAMERA = Camera(photons=20_000.0)
SEED = 1


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="folder for the files")
    asked = parser.parse_args()
    if asked.out is None:
        identify_picture(HERE)
        return
    asked.out.mkdir(parents=True, exist_ok=True)
    EXPERIMENT.write(asked.out / "experiment.toml")
    draw_picture(asked.out)
    draw_film(asked.out)
    trace_contour(asked.out)
    write_events(asked.out)
    (asked.out / "truth.toml").write_text(truth())


def view_of(radius, shape, half_width, centre):
    """Return the view of one capsule, and v_o/U."""
    ca = float(capillary_number(viscosity=VISCOSITY, mean_velocity=FLOW, surface_shear_modulus=MODULUS))
    place = {"capillary_number": ca, "size_ratio": radius / EXPERIMENT.half_width.value, "outline": True}
    seen = {view: Surrogate.open("square-neo-hookean", view=view).at(**place) for view in ("mid-plane", "silhouette")}
    outlines = (seen[view].outline[0] for view in ("mid-plane", "silhouette"))
    return View((Capsule(*outlines, centre),), half_width, shape), float(seen["mid-plane"].velocity_ratio[0])


def middle(shape):
    return 0.5 * (shape[1] - 1.0), 0.5 * (shape[0] - 1.0)


def draw_picture(folder):
    """Draw one capsule, and the empty channel."""
    view, _ = view_of(RADIUS, SHAPE, HALF_WIDTH, middle(SHAPE))
    picture, empty = photograph(view, CAMERA, seed=SEED)
    cv2.imwrite(str(folder / "capsule.png"), picture)
    cv2.imwrite(str(folder / "empty.png"), empty)


def draw_film(folder):
    """Draw the same capsule on its way through the picture, as Motion JPEG."""
    view, ratio = view_of(RADIUS, FILM_SHAPE, FILM_HALF_WIDTH, (REACH, middle(FILM_SHAPE)[1]))
    step = FLOW * ratio / EXPERIMENT.frame_rate.value / EXPERIMENT.half_width.value * FILM_HALF_WIDTH
    frames, _ = film(view, CAMERA, np.arange(0.0, FILM_SHAPE[1] - 2.0 * REACH, step), seed=SEED)
    size = FILM_SHAPE[1], FILM_SHAPE[0]
    kind, options = cv2.VideoWriter.fourcc(*"MJPG"), [cv2.VIDEOWRITER_PROP_QUALITY, 88]
    written = cv2.VideoWriter(str(folder / "film.avi"), cv2.CAP_OPENCV_MJPEG, kind, 25.0, size, options)
    for frame in frames:
        written.write(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR))
    written.release()


def trace_contour(folder):
    """Write the points that a person might click along the edge in the picture, half a pixel off or less."""
    view, _ = view_of(RADIUS, SHAPE, HALF_WIDTH, middle(SHAPE))
    whole = view.placed(view.capsules[0].profile, view.capsules[0])
    points = whole[:: len(whole) // 64]
    points = points + np.random.default_rng(SEED).normal(0.0, 0.25, points.shape)
    np.savetxt(folder / "contour.csv", points, fmt="%.2f", delimiter=",", header="x_px,y_px", comments="")


def write_events(folder):
    """Write three capsules as an .rtdc file: their pictures, their masks, and what else is read of such a file."""
    import h5py

    half_width = EXPERIMENT.half_width.value / PIXEL
    places = np.linspace(43.0, EVENT_SHAPE[1] - 44.0, len(RADII_OF_EVENTS))  # apart: the median is the empty channel
    shots = [
        view_of(radius, EVENT_SHAPE, half_width, (x, middle(EVENT_SHAPE)[1]))[0]
        for radius, x in zip(RADII_OF_EVENTS, places, strict=True)
    ]
    pictures = [photograph(view, CAMERA, seed=SEED + k)[0] for k, view in enumerate(shots)]
    with h5py.File(folder / "cells.rtdc", "w", track_order=False) as file:
        file.attrs["imaging:pixel size"] = 1e6 * PIXEL
        file.attrs["setup:channel width"] = 2e6 * EXPERIMENT.half_width.value
        file.attrs["setup:flow rate"] = 1e9 * FLOW * 4.0 * EXPERIMENT.half_width.value**2  # uL/s
        masks = [_filled(view) for view in shots]
        for name, arrays in (("image", pictures), ("mask", masks)):
            file.create_dataset(f"events/{name}", data=np.stack(arrays), compression="gzip", chunks=(1, *EVENT_SHAPE))


def _filled(view):
    """Return the pixels of a capsule, as the software of the microscope marks them."""
    corners = np.rint(view.placed(view.capsules[0].silhouette, view.capsules[0])).astype(np.int32)
    return cv2.fillPoly(np.zeros(view.shape, dtype=np.uint8), [corners], 255)


def truth():
    """Return what is true of the drawn capsules."""
    view, ratio = view_of(RADIUS, SHAPE, HALF_WIDTH, middle(SHAPE))
    lines = [
        "# Of the capsule in capsule.png, film.avi and contour.csv; written by pictures.py.",
        f'surface_shear_modulus = "{1e3 * MODULUS:g} mN/m"',
        f'capsule_radius = "{1e6 * RADIUS:g} um"',
        f'mean_velocity = "{1e3 * FLOW:g} mm/s"',
        f'capsule_velocity = "{1e3 * FLOW * ratio:.4f} mm/s"',
        f"axial_extent_over_l = {view.axial_extent / view.half_width:.4f}",
        f"axial_length_over_l = {view.axial_length / view.half_width:.4f}",
        "",
        "[events]  # of cells.rtdc, the modulus and the flow as above",
        f"capsule_radius = {[f'{1e6 * radius:g} um' for radius in RADII_OF_EVENTS]}".replace("'", '"'),
    ]
    return "\n".join(lines) + "\n"


def identify_picture(folder):
    """Measure the picture, and identify the capsule."""
    seen = measure(
        folder / "capsule.png",
        EXPERIMENT,
        background=folder / "empty.png",
        capsule_velocity="4.86 +/- 0.04 mm/s",
    )
    model = Surrogate.open("square-neo-hookean", view="silhouette")
    posterior = identify(replace(seen, source="capsule.png"), model, EXPERIMENT, engine="quadrature", seed=SEED)
    modulus, radius = (posterior.marginals[name] for name in ("surface_shear_modulus", "capsule_radius"))
    low, high = 1e3 * modulus.lower_95, 1e3 * modulus.upper_95
    print(f"a [um] = {1e6 * radius.median:.2f}; 95 % of G_s from {low:.1f} to {high:.1f} mN/m; {posterior.status}")
    print(f"G_s [mN/m] = {1e3 * modulus.median:.1f}")


if __name__ == "__main__":
    main()
