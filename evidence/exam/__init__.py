"""The exam: many blind sessions diagnosed, and the page of the answers; run as ``python -m evidence.exam``."""
