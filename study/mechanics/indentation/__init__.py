"""Contact laws in closed form, and moduli that indentation curves give by them."""
