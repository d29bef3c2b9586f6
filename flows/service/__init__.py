"""The loop under Prefect: tasks, display, servers and memory."""
