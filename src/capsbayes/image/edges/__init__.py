"""Edges and dark bands in a picture, located to a fraction of a pixel, and what follows from the edge of a capsule."""
