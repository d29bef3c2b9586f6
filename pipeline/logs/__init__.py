"""Logs from other people's robots: MCAP files read in a stream, with suspicion, in children with limits."""
