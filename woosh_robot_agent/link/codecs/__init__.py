"""Encodings of frames: JSON text and protobuf bytes."""
