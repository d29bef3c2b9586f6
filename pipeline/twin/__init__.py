"""The simulated real robot with hidden physics; only the deployment side may read it."""
