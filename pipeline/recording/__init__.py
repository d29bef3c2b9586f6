"""Recordings: MCAP files in the dialect of dialect.py; written whole, read with suspicion."""

from pipeline.recording.read import read_attachments, read_episode, read_frames
from pipeline.recording.recover import Recovered, recover
from pipeline.recording.write import Recording, write_episode, write_episodes

__all__ = ["Recording", "Recovered", "read_attachments", "read_episode", "read_frames", "recover", "write_episode",
           "write_episodes"]
