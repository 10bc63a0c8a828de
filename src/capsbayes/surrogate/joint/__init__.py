"""Joint surrogates: a database of one more parameter as a forward model with a further coordinate."""
