"""Cases, fits and refinements of a study, and how they are run."""
