"""Error terms: which variation an effect is compared with."""
