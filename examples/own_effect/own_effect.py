"""An effect of your own: flanks that look too broad, as their edges are drawn towards the dark lines of the walls."""

from dataclasses import dataclass, replace

import numpy as np

from capsbayes import Quantity, Surrogate
from capsbayes.model import Kind
from capsbayes.parameters import Parameter
from capsbayes.profile import vertex_normals
from capsbayes.testing import check_effect


@dataclass(frozen=True)
class DrawnFlanks:
    name = "flanks drawn to the walls"
    parameter = Parameter("flank_shift", "d_f", "d_f", "m", "µm", 1e6, "distance of the seen flanks from the true ones")
    null_value = 0.0
    kind = Kind.SESSION
    changes = "Flanks lie too far out, the more so where the edge runs along the walls; nose and rear are right."
    separated_by = "A picture of a bead that nearly touches the walls: it would look higher than long."
    circumstances = ("half_width",)
    prior = Quantity(0.0, 0.4e-6, "m", low=-np.inf)

    def __call__(self, model, theta, *, outline=False):
        seen = model(theta, outline=outline)
        if not outline:
            return seen
        normals = vertex_normals(seen.outline)
        distance = theta["flank_shift"] / theta["half_width"]
        return replace(seen, outline=seen.outline + (distance[:, None] * normals[..., 1] ** 4)[..., None] * normals)


def main():
    model = Surrogate.open("square-neo-hookean")
    check_effect(DrawnFlanks(), model)
    capsule = {"capillary_number": 0.05, "size_ratio": 0.9, "half_width": 25e-6, "flank_shift": 0.4e-6}
    seen = (model + DrawnFlanks()).at(**capsule, outline=True)
    print(f"breadth/l = {np.ptp(seen.outline[0, :, 1]):.3f}")


if __name__ == "__main__":
    main()
