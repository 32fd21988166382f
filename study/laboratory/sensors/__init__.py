"""Force sensors: how their errors propagate, and which errors a study allows."""
