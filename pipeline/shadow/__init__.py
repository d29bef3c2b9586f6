"""Shadow mode: candidates that see what the champion sees, in processes of their own, and cannot act."""
