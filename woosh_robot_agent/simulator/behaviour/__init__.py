"""Behaviour over time: jobs, the tasks and actions that consist of them, and their devices."""
