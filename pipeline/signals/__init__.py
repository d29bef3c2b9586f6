"""Signals of shadow mode: what is known of an attempt's risk while it goes on, from what the robot senses alone."""
