"""Error of the recording."""


class RecordingError(Exception):
    """The file is not a valid recording, or the libraries to read and write one are missing."""
