"""Browsing a store in Rerun."""
