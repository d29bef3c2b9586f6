"""Hierarchies of control: an upper part commands at its rate, a lower one acts at a higher one; each is replaceable."""
