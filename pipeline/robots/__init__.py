"""Robots that people drive, and the devices they drive them with."""
