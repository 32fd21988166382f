"""One fit of a study: starts, stages, summary."""
