"""The bench: one page in a browser from a picture to a report. It knows no physics: it calls what the commands call."""
