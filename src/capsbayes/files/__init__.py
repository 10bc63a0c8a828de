"""Files that are read and written: every key and cell checked, outputs whole or not at all."""

from capsbayes.files.output_file import guarded

__all__ = ["guarded"]
