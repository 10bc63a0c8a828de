"""Pages of results, one file a kind: HTML that holds its style and its pictures."""
