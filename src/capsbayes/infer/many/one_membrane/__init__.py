"""One membrane shared by the capsules of a batch: what it is, and the shear modulus and radius of each capsule."""
