"""The distribution that the capsules of a session share: its posterior, the selection of capsules, and checks."""
