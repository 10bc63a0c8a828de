"""Sets of measured capsules on disk: a folder of measurement files, a table of lengths, a file of outlines."""

from capsbayes.measurements.formats import read_set, write_set
from capsbayes.measurements.measured_set import MeasuredSet, check_comparable

__all__ = ["MeasuredSet", "check_comparable", "read_set", "write_set"]
