"""Benchmarks: each makes figures of a page, as ``python -m evidence.benchmarks.NAME``."""
