"""Encodings of the frames: JSON text and protobuf bytes."""
