"""Training and judging legged robots from the command line."""
