"""The steps of the page, one file a step."""
