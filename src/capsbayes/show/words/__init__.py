"""Sentences about results, the same on the terminal and on pages."""
