"""Behaviour over time, as jobs: each task or action consists of jobs, and a job owns a device."""
