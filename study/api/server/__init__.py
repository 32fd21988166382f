"""``study serve``: studies and their reports as pages, on this machine alone and read only."""
