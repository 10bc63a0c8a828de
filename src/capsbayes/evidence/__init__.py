"""Evidence for the rest: verification of the simulator, blind sessions with a hidden effect, and the exam."""
