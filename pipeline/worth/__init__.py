"""The worth of a batch of episodes: policies retrained with it and without it, played on the same scenes."""
