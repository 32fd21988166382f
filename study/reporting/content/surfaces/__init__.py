"""Words about surfaces over ranges, and about uncertain inputs carried through them."""
