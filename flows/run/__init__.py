"""One run: its stages, wired to the store."""
