"""The ground that all stages stand on: store, recordings, simulation, policies."""
