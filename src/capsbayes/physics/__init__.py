"""The forward problem: membrane laws, the surface of the sphere, Stokes flow, and the simulator built on them."""
