"""Checks of recordings and datasets: what is wrong, where, by how much, and the mend."""
