"""The selftest: planted faults, and who sees them."""
