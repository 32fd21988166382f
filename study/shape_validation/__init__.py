"""A simulated surface against a scan of the real one."""
