"""Materials: energies declared once, their closed-form tests, conversions, stability."""
