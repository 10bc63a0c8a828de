"""Measured outlines: their normal distances from predicted ones, and their likelihood."""
