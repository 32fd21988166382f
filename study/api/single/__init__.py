"""One simulation, one calibration, virtual measurements: verbs without a study."""
