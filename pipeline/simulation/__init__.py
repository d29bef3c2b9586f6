"""Simulation in three layers (robot body, scene, task) over one engine, MuJoCo's Batch."""
