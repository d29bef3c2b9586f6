"""LeRobot v3 folders, written and read directly: the view that trainings and other people's tools open."""
