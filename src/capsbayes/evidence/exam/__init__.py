"""The exam: many blind sessions diagnosed, and the table of the answers."""
