"""What every wing may use: errors, units, text files, curves, canonical JSON, compilation."""
