"""The commands of `hardcase`, a file a group."""
