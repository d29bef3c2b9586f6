"""Hierarchies of control: an upper part commands at its rate, a lower part acts at a higher one; each is replaceable."""
