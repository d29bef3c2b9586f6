"""What people do with recordings and dataset versions."""
