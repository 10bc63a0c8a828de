"""Rows of capsules whose lengths over l were measured, from a tabulated model by compiled code."""
