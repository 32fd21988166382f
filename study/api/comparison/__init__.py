"""The verb diff: two studies beside each other."""
