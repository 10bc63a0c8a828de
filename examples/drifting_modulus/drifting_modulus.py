"""G_s that drifts with the flow rate, and what it is when the effect that makes it drift is in the model.

Forty capsules of one batch in a square channel at four settings of the pump, each measured once. How they were made
is in truth.json: look at it last.
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from capsbayes import Session, Surrogate, diagnose

HERE = Path(__file__).parent
BETWEEN = (3.8e-3, 4.7e-3, 5.9e-3)  # m/s, of v_o: from one setting of the pump to the next


def by_setting(compared):
    """Median velocity [m/s] and apparent G_s [N/m] at each setting of the pump : (2, 4) array."""
    velocity = compared.session.circumstances["capsule_velocity"]
    setting = np.digitize(velocity, BETWEEN)
    return np.array(
        [(np.median(velocity[setting == i]), np.nanmedian(compared.modulus[setting == i])) for i in range(4)]
    ).T


def picture(before, after, path):
    """Apparent G_s of the capsules laid aside against their velocity, without and with the effect."""
    figure, axes = plt.subplots(figsize=(5.5, 3.5), layout="constrained")
    for compared, label, colour in ((before, "model as it was", "tab:red"), (after, "with the effect", "tab:blue")):
        velocity = 1e3 * compared.session.circumstances["capsule_velocity"]
        axes.errorbar(
            velocity,
            1e3 * compared.modulus,
            1e3 * compared.modulus_error,
            fmt="o",
            ms=4,
            lw=1,
            color=colour,
            label=label,
        )
        axes.plot(*(1e3 * by_setting(compared)), "_", ms=28, mew=3, color=colour)
    axes.set(xlabel="$v_o$ [mm/s]", ylabel="apparent $G_s$ [mN/m]", ylim=(0.0, None))
    axes.legend(frameon=False)
    figure.savefig(path, dpi=150)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--picture", type=Path, help="where to draw G_s against velocity")
    arguments = parser.parse_args()
    session = Session.read(HERE / "capsules")
    study = diagnose(session, Surrogate.open("square-neo-hookean"), seed=1)
    print(study)
    before, after = study.verification.compared
    print("v_o [mm/s]   G_s [mN/m] before   after")
    for (velocity, without), (_, within) in zip(by_setting(before).T, by_setting(after).T, strict=True):
        print(f"{1e3 * velocity:10.2f}   {1e3 * without:17.1f}   {1e3 * within:5.1f}")
    print(f"G_s [mN/m] = {1e3 * after.median_modulus:.1f}")
    if arguments.picture:
        picture(before, after, arguments.picture)


if __name__ == "__main__":
    main()
