"""The exact engine for a model with several further coordinates: importance sampling from a fitted mixture."""
