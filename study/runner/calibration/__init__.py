"""Constants from measured tests: the verb `calibrate`."""
