"""Databases of steady shapes: the cases of each size ratio, computed in parallel and resumed after an interruption."""

from capsbayes.physics.databases.build import build_database

__all__ = ["build_database"]
