"""Stokes flow in a channel that holds a membrane: undisturbed flows, the single layer, and the response of the walls.

Lengths are over the half width l, velocities over the mean undisturbed velocity U, stresses over mu U / l; the flow is
along z. `cross_sections` has the channels by name, `single_layer` the velocity that the membrane induces (compiled in
`layer_kernel` and `stokeslet`), `walls` the Stokeslets outside the channel that cancel it there (Pozrikidis 1992, doi
10.1017/CBO9780511624124; Fairweather & Karageorghis 1998, doi 10.1023/A:1018981221740).
"""
