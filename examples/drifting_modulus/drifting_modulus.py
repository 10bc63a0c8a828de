"""A shear modulus that drifts with the flow rate, and its value with the effect in the model.

Forty capsules of one batch in a square channel at four settings of the pump, each measured once. truth.json says how
they were made: look at it last.
"""

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from capsbayes import Session, Surrogate, diagnose

HERE = Path(__file__).parent


def picture(before, after, path):
    """Draw the apparent G_s of the held-out capsules against their velocity, without and with the effect."""
    figure, axes = plt.subplots(figsize=(5.5, 3.5), layout="constrained")
    for comparison, label, colour in ((before, "model as it was", "tab:red"), (after, "with the effect", "tab:blue")):
        velocity = 1e3 * comparison.session.circumstances["capsule_velocity"]
        axes.errorbar(
            velocity,
            1e3 * comparison.modulus,
            1e3 * comparison.modulus_error,
            fmt="o",
            ms=4,
            lw=1,
            color=colour,
            label=label,
        )
        for rate, (_, median) in comparison.modulus_at_flow_rates.items():
            there = np.median(velocity[comparison.session.flow_rates == rate])
            axes.plot(there, 1e3 * median, "_", ms=28, mew=3, color=colour)
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
    before, after = study.verification.comparisons
    print("Q [uL/min]   G_s [mN/m] before   after")
    for rate, (_, without) in before.modulus_at_flow_rates.items():
        within = after.modulus_at_flow_rates[rate][1]
        print(f"{6e10 * rate:10.2f}   {1e3 * without:17.2f}   {1e3 * within:5.2f}")
    print(f"G_s [mN/m] = {1e3 * after.median_modulus:.1f}")
    if arguments.picture:
        picture(before, after, arguments.picture)


if __name__ == "__main__":
    main()
