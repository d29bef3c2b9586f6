"""Known faults planted in clean recordings and datasets, to see whether the checks find them."""
