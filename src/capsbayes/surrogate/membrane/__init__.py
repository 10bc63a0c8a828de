"""Diffuse approximation over the parameters of flow and membrane, from scattered states with their derivatives."""
