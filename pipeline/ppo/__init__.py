"""PPO on attempts of legged robots: SB3's algorithm, with environments, checkpoints and exports of our own."""
