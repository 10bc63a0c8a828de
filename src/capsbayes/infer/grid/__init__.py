"""The exact engine: the posterior of one capsule on a grid over (log Ca, a/l)."""
