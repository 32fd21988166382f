"""Gaussian-process emulators of responses (Rasmussen and Williams 2006; Saltelli et al. 2008)."""
