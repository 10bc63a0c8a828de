"""The sampling engine: ensembles of walkers, extended until they have converged."""
