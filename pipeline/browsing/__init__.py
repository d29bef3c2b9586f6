"""Browsing: episodes as Rerun recordings, a catalog of them, and the viewer out of the installed package."""
