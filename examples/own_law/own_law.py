"""A membrane law of your own, checked and simulated: that of Evans and Skalak for red cells.

W = (I1 + 2) / (2 J) - 1 + K/2 (J - 1)^2 over G_s, with J = sqrt(I2 + 1) the area over that at rest and K = K_s / G_s.
E. A. Evans and R. Skalak, Mechanics and Thermodynamics of Biomembranes, CRC Press (1980).
"""

from dataclasses import dataclass

import numpy as np

from capsbayes import Simulator
from capsbayes.physics.membrane import MembraneLaw
from capsbayes.testing import check_law


@dataclass(frozen=True)
class EvansSkalak(MembraneLaw):
    area_dilation_modulus: float = 3.0

    @property
    def name(self):
        return f"Evans-Skalak K = {self.area_dilation_modulus}"

    def derivatives(self, i1, i2):
        modulus, j = self.area_dilation_modulus, np.sqrt(i2 + 1)
        w = (i1 + 2) / (2 * j) - 1 + modulus / 2 * (j - 1) ** 2
        w_j = modulus * (j - 1) - (i1 + 2) / (2 * j**2)  # dW/dJ; dJ/dI2 = 1 / (2 J)
        w_jj = modulus + (i1 + 2) / j**3
        return w, 1 / (2 * j), w_j / (2 * j), np.zeros_like(j), -1 / (4 * j**3), (w_jj - w_j / j) / (4 * j**2)


def main():
    law = EvansSkalak(area_dilation_modulus=3.0)
    check_law(law)
    state = Simulator(law=law, refinement=4).run(capillary_number=0.05, size_ratio=0.8)
    print(f"{law.name}: {state.status}")
    print(f"L_z/l = {state.profile.axial_extent:.3f}")
    print(f"v_o/U = {state.velocity_ratio:.3f}")


if __name__ == "__main__":
    main()
