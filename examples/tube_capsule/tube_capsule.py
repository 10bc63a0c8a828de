"""A real capsule in a circular tube, from its picture to K_s, with three membrane laws and with the membrane unknown.

The picture is that of Risso et al. 2006 (doi 10.1017/S0022112005007652), published with Lin et al. 2023 (doi
10.1007/s10237-023-01712-7): a capsule of human serum albumin and alginate in a tube of 4 mm. It is not part of this
library: FOLDER contains `capsule.png` and, of the empty tube, `background.png`. mu U is 0.028 N/m; compression between
plates gave K_s = 0.55 N/m, the network of Lin et al. gives 0.58 N/m from the same picture.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from capsbayes import Experiment, MembraneSurrogate, Surrogate, identify
from capsbayes.image import Picture, detect
from capsbayes.image.measure import measurement_of
from capsbayes.image.overlay import write_overlay
from capsbayes.infer import Prior
from capsbayes.infer.outline import aligned_with
from capsbayes.measurement import askew_size
from capsbayes.quantity import Quantity
from capsbayes.report import write_report

STRESS = 0.028  # N/m, mu U
VISCOSITY, RATIO = 1.0, 1.33  # Pa s, which is not known alone; and v_o/U, to which nothing here is sensitive
EXPERIMENT = Experiment(cross_section="circular", half_width=2e-3, viscosity=VISCOSITY)
VELOCITY = Quantity(RATIO * STRESS / VISCOSITY, 0.01 * RATIO * STRESS / VISCOSITY, "m/s")
# of the order that compression gave: without it, the large errors of the shapes next to the snap-through leave 3 % to
# capsules that are fifteen times as stiff
PRIOR = Prior(surface_shear_modulus=Quantity.log_uniform(0.01, 1.0), capsule_radius=Quantity.uniform(1e-3, 2e-3))
LAWS = {
    "neo-Hookean": "circular-neo-hookean",
    "Skalak, C = 1": "circular-skalak",
    "Hooke, nu_s = 0.5": "circular-hooke",
}
UNKNOWN = "membrane unknown"
COLOURS = ("tab:red", "tab:blue", "tab:green", "black")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="with capsule.png and background.png")
    parser.add_argument("--out", type=Path, help="folder for overlay.png and a page for each law")
    parser.add_argument("--picture", type=Path, help="where to draw the silhouette with those of the laws")
    asked = parser.parse_args()
    picture = Picture.read(asked.folder / "capsule.png")
    detection = detect(picture, background=Picture.read(asked.folder / "background.png"), flow="right")
    measured = measurement_of(detection, picture, EXPERIMENT, VELOCITY)
    for name in ("axial_extent", "axial_length"):
        print(f"{name} / R: {getattr(measured, name):.4f} +/- {getattr(measured, f'{name}_error'):.4f}")
    outline, half_width = measured.outline, detection.walls.half_width
    print(f"of which the place of the membrane in the rear's dark band: {detection.rear.within / half_width:.4f} R")
    scale, rear = 1e3 * outline.noise.scale, 1e3 * outline.pose.rear
    print(f"errors of the silhouette: {scale:.1f} R/1000; of the rear, whose edge is a band, {rear:.0f}")
    print(f"odd part of the silhouette: {1e3 * askew_size(outline.points, outline.noise):.1f} R/1000")
    plain, lengths, silhouettes = replace(measured, outline=None), {}, {}
    for law, database in LAWS.items():
        lengths[law] = identified(plain, Surrogate.open(database), law, "lengths")
        silhouettes[law] = identified(measured, Surrogate.open(database, view="silhouette"), law, "silhouette")
    identified(plain, MembraneSurrogate.open("circular"), UNKNOWN, "lengths")
    unknown = MembraneSurrogate.open("circular", view="silhouette")
    silhouettes[UNKNOWN] = identified(measured, unknown, UNKNOWN, "silhouette")
    far = replace(outline, points=without_corners(outline.points))
    identified(replace(measured, outline=far), unknown, UNKNOWN, "no corners")
    if asked.out is not None:
        asked.out.mkdir(parents=True, exist_ok=True)
        write_overlay(asked.out / "overlay.png", picture, detection)
        for law, posterior in lengths.items():
            write_report(posterior, asked.out / f"{LAWS[law]}.html", picture=asked.folder / "capsule.png")
    if asked.picture is not None:
        draw(measured.outline.points, silhouettes, asked.picture)
    skalak = lengths["Skalak, C = 1"].marginals["capillary_number"].median
    print(f"K_s [N/m] = {3.0 * STRESS / skalak:.3f}")


def identified(measurement, model, law, what):
    """Return the posterior of the capsule, and print K_s, which is 3 G_s in all three laws, and the misfit."""
    posterior = identify(measurement, model, EXPERIMENT, seed=1, prior=PRIOR, engine="quadrature")
    draws = posterior.draws
    moduli = draws["surface_shear_modulus"] * draws.get("area_dilation_modulus", 3.0)
    low, middle, high = np.quantile(moduli, (0.025, 0.5, 0.975))
    ca, size = (posterior.marginals[name].median for name in ("capillary_number", "size_ratio"))
    misfit = "".join(f"   misfit {gate.value:.1f}" for gate in posterior.gates if "misfit of the outline" in gate.name)
    print(
        f"{law:18} {what:11} K_s {middle:.3f} N/m [{low:.3f}, {high:.3f}]   Ca {ca:.4f}   a/R {size:.4f}{misfit}   "
        f"{posterior.status.name}"
    )
    for name in model.coordinates:
        print(f"{'':18} {name} {posterior.marginals[name].median:.3g}")
    for gate in posterior.gates:
        if not gate.passed:
            print(f"{'':18} {gate}")
    return posterior


def without_corners(points):
    """Return the points of a silhouette that are more than 0.2 R away from the two corners of its rear."""
    corners = [points[np.argmax(side * points[:, 1] - points[:, 0])] for side in (-1.0, 1.0)]
    return points[np.min([np.linalg.norm(points - corner, axis=1) for corner in corners], axis=0) > 0.2]


def draw(points, silhouettes, path):
    """Draw the measured silhouette with the best of each law, and their distance."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 4.0), layout="constrained")
    for colour, (law, posterior) in zip(COLOURS, silhouettes.items(), strict=True):
        outline = posterior.outlines[np.argmin([misfit(points, each) for each in posterior.outlines])]
        seen, feet = aligned_with(points, outline)
        left.plot(*np.vstack([outline, outline[:1]]).T, color=colour, lw=1, label=law)
        order = np.argsort(feet.place)
        right.plot(100 * feet.place[order] / len(outline), 1e3 * feet.distance[order], color=colour, lw=1)
    left.plot(*seen.T, "k.", ms=3, label="measured")
    left.set(xlabel="z/R", ylabel="y/R", aspect="equal")
    left.legend(frameon=False, loc="center")
    right.axhline(0.0, color="0.7", lw=1)
    right.set(xlabel="from the nose [% of the perimeter]", ylabel="measured beyond predicted edge [R/1000]")
    figure.savefig(path, dpi=150)


def misfit(points, outline):
    return np.sum(aligned_with(points, outline)[1].distance ** 2)


if __name__ == "__main__":
    main()
