"""The verb converge: of a problem, of the cells of a design, and its page."""
