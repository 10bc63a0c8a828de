"""Results on the terminal, a file for each kind: the same sentences and tables as on their pages."""
