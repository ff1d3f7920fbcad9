"""Requests, answers, pushes and reports, as protobuf messages."""
