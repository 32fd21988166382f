"""Records on disk: sealed documents, the store, its index, locks."""
