"""An effect of your own, checked and added to a model: a camera whose pixels are not quite square.

Lengths along the flow appear longer by a factor 1 + s than those across it, where the walls give the scale.
"""

from dataclasses import dataclass, replace

import numpy as np

from capsbayes import Quantity, Surrogate
from capsbayes.effect import Kind
from capsbayes.parameters import Parameter
from capsbayes.testing import check_effect


@dataclass(frozen=True)
class OblongPixels:
    name = "oblong pixels"
    parameter = Parameter("oblong", "s", "s", "-", "%", 100.0, "pixels along the flow over those across, less one")
    null_value = 0.0
    kind = Kind.SESSION
    changes = "Everything is longer along the flow by one factor."
    separated_by = "A picture of a ruled slide in both directions."
    circumstances = ()
    prior = Quantity(0.0, 0.01, low=-np.inf)

    def __call__(self, model, theta, *, outline=False):
        seen, longer = model(theta, outline=outline), 1.0 + theta["oblong"]
        lengths = {"axial_extent": seen.axial_extent * longer, "axial_length": seen.axial_length * longer}
        stretched = seen.outline * np.stack([longer, np.ones_like(longer)], axis=1)[:, None] if outline else None
        return replace(seen, **lengths, velocity_ratio=seen.velocity_ratio * longer, outline=stretched)


def main():
    model = Surrogate.open("square-neo-hookean")
    check_effect(OblongPixels(), model)
    seen = (model + OblongPixels())(
        {"capillary_number": np.array([0.05]), "size_ratio": np.array([0.9]), "oblong": np.array([0.02])}
    )
    print(f"L_z/l = {seen.axial_extent[0]:.3f}")
    print(f"v_o/U = {seen.velocity_ratio[0]:.3f}")


if __name__ == "__main__":
    main()
