"""Limits of what the master control may send; larger messages take too long to handle."""

MAX_MESSAGE_SIZE = 2 * 2**20
"""Maximum length of a message, in bytes."""
MAX_TEXT = 10_000
"""Maximum length of a text in a message, in characters."""
MAX_INSTANT_ACTIONS = 100
"""Maximum number of actions in a message with instant actions."""
MAX_NODES = 1000
"""Maximum number of nodes of an order."""
MAX_DEGREE = 5
"""Maximum degree of a trajectory."""
MAX_CONTROL_POINTS = 500
"""Maximum number of control points of a trajectory."""
MAX_KNOTS = MAX_CONTROL_POINTS + MAX_DEGREE + 1
"""Maximum number of knots of a trajectory."""
