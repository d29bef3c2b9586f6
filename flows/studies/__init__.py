"""Studies: what stands in docs/results.md, a command each."""
