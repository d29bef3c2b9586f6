"""Policies: what is learnt from a dataset version, and how it is carried to a robot."""
