"""Redaction: what a map names is hidden in a derived version; what was done is checked, counted and signed."""
