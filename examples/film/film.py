"""A drawn film of three capsules whose parameters are known.

Capsules of one shear modulus and three sizes follow each other through a square channel. `--out film/` writes the
frames, the picture of the empty channel and the experiment file; without it the film of one capsule is drawn,
measured, identified and deleted.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

from capsbayes import Experiment, Surrogate, identify
from capsbayes.experiment import capillary_number
from capsbayes.image.film import measure_film
from capsbayes.quantity import Quantity

sys.path.insert(0, str(Path(__file__).parents[2]))
from evidence.synthetic import Optics, Scene, draw

MODULUS = 50e-3  # N/m, of all membranes
RADII = (22.5e-6, 23.5e-6, 24.5e-6)  # m
FLOW = 3.75e-3  # m/s, mean velocity of the liquid
EXPERIMENT = Experiment(
    cross_section="square",
    half_width=Quantity(25e-6, 0.2e-6),
    viscosity=Quantity(0.80, 0.02),
    frame_rate=Quantity(500.0, 0.0, "1/s"),
)
HALF_WIDTH, SHAPE = 60.0, (160, 460)  # px
OPTICS = Optics(blur=1.0, motion=1.5)
REACH = 70.0  # px from the middle of a capsule that has to be whole in the picture


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="folder for frames/, empty.png and experiment.toml")
    asked = parser.parse_args()
    if asked.out is not None:
        write_film(asked.out, RADII)
        return
    with tempfile.TemporaryDirectory() as folder:
        write_film(Path(folder), RADII[1:2])
        identify_film(Path(folder))


def write_film(folder, radii):
    """Draw each capsule on its way through the picture, one after the other."""
    frames = [drawing for radius in radii for drawing in passing(radius)]
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    for number, drawing in enumerate(frames):
        cv2.imwrite(str(folder / "frames" / f"{number:03d}.png"), drawing.picture)
    cv2.imwrite(str(folder / "empty.png"), frames[0].background)
    EXPERIMENT.write(folder / "experiment.toml")


def passing(radius):
    """Yield the pictures of one capsule while the whole capsule is visible."""
    width = 25e-6
    ca = float(capillary_number(viscosity=0.80, mean_velocity=FLOW, surface_shear_modulus=MODULUS))
    seen = {
        view: Surrogate.open("square-neo-hookean", view=view).at(
            capillary_number=ca, size_ratio=radius / width, outline=True
        )
        for view in ("mid-plane", "silhouette")
    }
    velocity = FLOW * seen["mid-plane"].velocity_ratio[0]
    step = velocity / EXPERIMENT.frame_rate.value / width * HALF_WIDTH
    print(f"drawn: a = {1e6 * radius:.1f} um, v_o = {1e3 * velocity:.3f} mm/s, {step:.1f} px a frame")
    for x in np.arange(REACH, SHAPE[1] - REACH, step):
        scene = Scene(
            seen["mid-plane"].outline[0], seen["silhouette"].outline[0], HALF_WIDTH, SHAPE, (float(x), SHAPE[0] / 2)
        )
        yield draw(scene, OPTICS, seed=int(1e9 * radius) + int(x))


def identify_film(folder):
    """Measure the film, and identify each capsule."""
    film = measure_film(
        folder / "frames", EXPERIMENT, frame_rate=EXPERIMENT.frame_rate, background=folder / "empty.png"
    )
    model = Surrogate.open("square-neo-hookean", view="silhouette")
    for capsule in film.capsules:
        posterior = identify(capsule.measurement, model, EXPERIMENT, engine="quadrature", seed=1)
        modulus, radius = (posterior.marginals[name] for name in ("surface_shear_modulus", "capsule_radius"))
        low, high = 1e3 * modulus.lower_95, 1e3 * modulus.upper_95
        print(f"a [um] = {1e6 * radius.median:.2f}; 95 % of G_s from {low:.1f} to {high:.1f} mN/m; {posterior.status}")
        print(f"G_s [mN/m] = {1e3 * modulus.median:.1f}")


if __name__ == "__main__":
    main()
