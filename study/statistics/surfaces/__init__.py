"""Response surfaces: quadratics and Gaussian processes, optima, inversion, propagation."""
