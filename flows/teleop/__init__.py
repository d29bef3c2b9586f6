"""Driving, recording and filming robots by hand."""
