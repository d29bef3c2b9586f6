"""What data is: frozen models that travel between stages; imports nothing of ours but itself."""
