"""Legged robots: bodies, tasks, many of them side by side in one Batch, and the environments that PPO learns in."""
