"""Branches of steady states: from rest, along Ca and a/l, through folds, and the shape that a capsule settles to."""
