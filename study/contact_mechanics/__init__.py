"""Contact mechanics in closed form: small indentations of a layer, and the modulus behind them."""
