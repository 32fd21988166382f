"""Records of finished cases, the crash-safe store and the tidy table."""
