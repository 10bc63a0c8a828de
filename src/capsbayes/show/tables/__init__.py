"""Tables of results: each is made once and drawn on the terminal and in HTML by `table`."""
