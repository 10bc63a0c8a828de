"""The exam: many blind sessions diagnosed, and the page of the answers."""
